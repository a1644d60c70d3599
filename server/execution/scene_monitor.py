"""Looks again at the rest of a motion that runs, whenever the scene changes."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Protocol

from planners.pool import PlannerPool
from planners.problem import MoveItErrorCode, PlanningFailure, RecheckAnswer, RecheckQuestion
from planners.scene import Scene

log = logging.getLogger("armbridge.execution")


class WatchedScene(Protocol):
    """What is asked of the planning scene here."""

    @property
    def scene(self) -> Scene:
        """The present scene."""

    def on_change(self, callback: Callable[[], None], /) -> None:
        """Have this called after every change."""


class SceneWatch:
    """Guards one motion at a time.

    Args:
        pool: who looks.
        state: the planning scene.
        patience_s: for how long a planner that does not answer in time is asked again [s]; as long as the arm may be
            silent, for a busy machine keeps both from the cores.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        pool: PlannerPool,
        state: WatchedScene,
        patience_s: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._pool = pool
        self._state = state
        self._patience_s = patience_s
        self._clock = clock
        self._seen = 0
        self._question: Callable[[], RecheckQuestion] | None = None
        self._on_contact: Callable[[PlanningFailure], None] = lambda _contact: None
        self._task: asyncio.Task[None] | None = None
        state.on_change(self._changed)

    async def look(self, question: Callable[[], RecheckQuestion]) -> PlanningFailure | None:
        """Tell what a motion would touch in the present scene, or why that cannot be told; None when it is free.

        Args:
            question: asks about what is left of the motion.
        """
        until_s = self._clock() + self._patience_s
        while True:
            scene = self._state.scene
            answer = await self._pool.ask(question(), scene)
            if not _too_late(answer) or self._clock() >= until_s:
                break
        self._seen = scene.version
        if isinstance(answer, PlanningFailure):
            message = f"whether the motion is free cannot be told: {answer.message}"
            return PlanningFailure(MoveItErrorCode.COLLISION_CHECKING_UNAVAILABLE, message, answer.details)
        return answer.contact

    def begin(
        self, seen: int, question: Callable[[], RecheckQuestion], on_contact: Callable[[PlanningFailure], None]
    ) -> None:
        """Guard a motion until :meth:`end`.

        Args:
            seen: version of the scene in which it was found free.
            question: asks about what is left of it.
            on_contact: called when that is no longer free; the motion is not looked at any more.
        """
        self._seen, self._question, self._on_contact = seen, question, on_contact
        self._changed()

    def end(self) -> None:
        """Guard no motion any more."""
        self._question = None
        if self._task is not None:
            self._task.cancel()
            self._task = None

    def _changed(self) -> None:
        if self._question is not None and self._task is None:
            self._task = asyncio.create_task(self._look_on(), name="look at the rest of the motion")

    async def _look_on(self) -> None:
        """Look until the scene no longer changes meanwhile."""
        contact = None
        while self._question is not None and contact is None and self._state.scene.version != self._seen:
            contact = await self.look(self._question)
        self._task = None
        if contact is not None and self._question is not None:
            self._question = None
            log.warning("the scene has changed: %s", contact.message)
            self._on_contact(contact)


def _too_late(answer: RecheckAnswer | PlanningFailure) -> bool:
    return isinstance(answer, PlanningFailure) and answer.code is MoveItErrorCode.TIMED_OUT
