"""Handle on a planner process: it is sent scenes and requests, and each request gets one answer."""

from __future__ import annotations

import asyncio
import functools
import logging
from collections.abc import Callable
from typing import Any, TypeAlias

from planners.messages import Answered, Ask, Cancel, Loaded, LoadFailed, LoadRobot, StillSearching
from planners.problem import ANSWER_TO, Answer, MoveItErrorCode, PlanningFailure, Request
from planners.scene import Scene
from planners.scene_transfer import SceneSender
from robot.description.model import RobotModel
from robot.processes import Child, StartedChild

log = logging.getLogger("armbridge.planners")

# The module whose main is the process.
WORKER_MODULE = "planners.worker"

# Planning gives way to the servo loop and the server, which have deadlines. Answers that a moving arm waits for do not.
NICENESS = 5

# Cancelling takes about a millisecond; past this, native code hangs. Among 12 other programs a worker waited for a core
# for 50 ms at most.
CANCEL_TIMEOUT_S = 1.0

# A process whose socket is closed is about to end; its exit code comes a moment later.
ENDING_TIMEOUT_S = 0.1

# Called with the allowed time that a problem has taken [s] when this is longer than most take.
OnHard: TypeAlias = Callable[[float], None]


def ignore(_spent_s: float) -> None:
    """Do nothing about a hard problem."""


class WorkerProcess:
    """A planner process; it is ``loaded`` once it has ever been ready for requests.

    An ``urgent`` process has normal priority. ``on_loaded`` is called once, with None when it is ready for requests, or
    with the reason for which it never will be; ``on_exit`` once when the process is gone.
    """

    def __init__(
        self,
        robot: RobotModel,
        memory_limit_bytes: int,
        on_loaded: Callable[[WorkerProcess, str | None], None],
        on_exit: Callable[[WorkerProcess], None],
        *,
        urgent: bool = False,
    ) -> None:
        self.urgent = urgent
        self._load = LoadRobot(robot, memory_limit_bytes)
        self._on_loaded = on_loaded
        self._on_exit = on_exit
        self._child = Child(
            StartedChild(WORKER_MODULE), self._received, self._exited, niceness=0 if urgent else NICENESS
        )
        self._ending = False
        self._number = 0
        self.loaded = False
        # None stands for the process's end.
        self._answer: asyncio.Future[Any] | None = None
        self._on_hard: OnHard = ignore
        self._scenes = SceneSender(self._child.send, functools.partial(asyncio.sleep, 0))

    async def start(self) -> None:
        """Have the process load the robot; it does so while others run."""
        await self._child.connect()
        self._child.send(self._load)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._child.pid

    @property
    def usable(self) -> bool:
        """True when it can take a request: it has loaded the robot, runs, and does not intend to end."""
        return self.loaded and not self._ending and self._child.running

    @property
    def ending(self) -> str:
        """Description of the process's end, or that it has not ended."""
        return self._child.ending

    def has(self, scene: Scene) -> bool:
        """Return true if the process has this scene."""
        return self._scenes.has_sent(scene)

    async def ask(self, request: Request, scene: Scene, on_hard: OnHard = ignore) -> Answer:
        """Send a request, after the scene unless the process has it, and wait for the answer.

        The wait has no end of its own; the caller that gives it up must :meth:`cancel` or :meth:`kill`. A process that
        dies, or sends no answer to the request, answers CRASH. ``on_hard`` is called when a problem takes longer than
        most, and again each time that this has doubled.
        """
        self._number += 1
        self._on_hard = on_hard
        self._answer = asyncio.get_running_loop().create_future()
        try:
            await self._scenes.send(scene)
            self._child.send(Ask(self._number, request))
        except ValueError as error:
            return PlanningFailure(MoveItErrorCode.FAILURE, f"the problem cannot be given to a planner: {error}")
        answer = await asyncio.shield(self._answer)
        if isinstance(answer, ANSWER_TO[type(request)] | PlanningFailure):
            return answer
        # Not the expected answer: the process must not get the next request.
        self._ending = True
        if answer is None:
            await self._child.wait(ENDING_TIMEOUT_S)
            message = f"the planner process ended ({self.ending}) while it worked on this"
        else:
            message = f"the planner answered a {type(request).__name__} with {type(answer).__name__}"
        return PlanningFailure(MoveItErrorCode.CRASH, message)

    async def cancel(self) -> None:
        """Make the process give up its request, or end it when it does not listen."""
        if self._answer is None or not self._scenes.complete:
            return  # the request was given up before it was sent
        self._child.send(Cancel(self._number))
        try:
            async with asyncio.timeout(CANCEL_TIMEOUT_S):
                await asyncio.shield(self._answer)
        except TimeoutError:
            log.warning("planner process %d does not listen and is ended", self.pid)
            await self.kill()

    async def kill(self) -> None:
        """End the process at once."""
        self._ending = True
        await self._child.kill()

    def _received(self, message: Any) -> None:
        match message:
            case Loaded():
                self.loaded = True
                self._on_loaded(self, None)
            case LoadFailed(reason):
                self._on_loaded(self, reason)
            case StillSearching(number, spent_s) if number == self._number:
                self._on_hard(spent_s)
            case Answered(number, answer, ending) if number == self._number:
                self._ending = self._ending or ending
                self._resolve(answer)

    def _exited(self) -> None:
        self._ending = True
        self._resolve(None)
        self._on_exit(self)

    def _resolve(self, answer: Answer | None) -> None:
        if self._answer is not None and not self._answer.done():
            self._answer.set_result(answer)
