"""Monitor that checks the rest of the motion under way again whenever the scene changes."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Protocol

from planners.pool import PlannerPool
from planners.problem import MoveItErrorCode, PlanningFailure, RecheckAnswer, RecheckQuestion
from planners.scene import Scene
from server.errors import RefusedError

log = logging.getLogger("armbridge.execution")


class SceneSource(Protocol):
    """The planning scene, as `server.moveit.scene.scene_state.SceneState`."""

    @property
    def scene(self) -> Scene:
        """The present scene."""

    def on_change(self, callback: Callable[[], None], /) -> None:
        """Have this called after every change."""


class SceneMonitor:
    """Monitor of one motion at a time.

    Args:
        pool: the planners, which check.
        source: the planning scene.
        retry_for_s: time during which a planner that does not answer in time is asked again [s]; as long as the arm
            may be silent, for a busy machine keeps both from the cores.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        pool: PlannerPool,
        source: SceneSource,
        retry_for_s: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._pool = pool
        self._source = source
        self._retry_for_s = retry_for_s
        self._clock = clock
        self._checked_version = 0
        self._question: Callable[[], RecheckQuestion] | None = None
        self._on_contact: Callable[[PlanningFailure], None] = lambda _contact: None
        self._task: asyncio.Task[None] | None = None
        source.on_change(self._on_change)

    async def check(self, question: Callable[[], RecheckQuestion]) -> None:
        """Check a motion in the present scene.

        Args:
            question: asks about the rest of the motion.

        Raises:
            RefusedError: the motion would touch something, or the planners cannot check it.
        """
        until_s = self._clock() + self._retry_for_s
        while True:
            scene = self._source.scene
            answer = await self._pool.ask(question(), scene)
            if not _is_late(answer) or self._clock() >= until_s:
                break
        self._checked_version = scene.version
        if isinstance(answer, PlanningFailure):
            message = f"whether the motion is free cannot be told: {answer.message}"
            raise RefusedError(PlanningFailure(MoveItErrorCode.COLLISION_CHECKING_UNAVAILABLE, message, answer.details))
        if answer.contact is not None:
            raise RefusedError(answer.contact)

    def start(
        self, version: int, question: Callable[[], RecheckQuestion], on_contact: Callable[[PlanningFailure], None]
    ) -> None:
        """Monitor a motion until :meth:`stop`.

        Args:
            version: of the scene in which the motion was found free.
            question: asks about the rest of it.
            on_contact: called once, when the motion is no longer free; the monitor then stops.
        """
        self._checked_version, self._question, self._on_contact = version, question, on_contact
        self._on_change()

    def stop(self) -> None:
        """Stop the monitor."""
        self._question = None
        if self._task is not None:
            self._task.cancel()
            self._task = None

    def _on_change(self) -> None:
        if self._question is not None and self._task is None:
            self._task = asyncio.create_task(self._check_changes(), name="check the rest of the motion")

    async def _check_changes(self) -> None:
        """Check until the scene no longer changes meanwhile."""
        try:
            while self._question is not None and self._source.scene.version != self._checked_version:
                await self.check(self._question)
        except RefusedError as error:
            if self._question is not None:
                self._question = None
                log.warning("the scene has changed: %s", error)
                self._on_contact(error.failure)
        self._task = None


def _is_late(answer: RecheckAnswer | PlanningFailure) -> bool:
    return isinstance(answer, PlanningFailure) and answer.code is MoveItErrorCode.TIMED_OUT
