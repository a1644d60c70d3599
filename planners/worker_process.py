"""One planner process, as the pool sees it: what it has been given, and the request in its hands."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import logging
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from typing import Any

from planners.budget import Deadline, read_run_delay_s
from planners.messages import (
    Answered,
    Ask,
    Cancel,
    Loaded,
    LoadFailed,
    LoadRobot,
    MoreObjects,
    NewScene,
)
from planners.problem import (
    Answer,
    CartesianPlan,
    CartesianProblem,
    IkAnswer,
    IkQuestion,
    MoveItErrorCode,
    Plan,
    PlanningFailure,
    PlanningProblem,
    RecheckAnswer,
    RecheckQuestion,
    Request,
    StateAnswer,
    StateQuestion,
)
from planners.scene import EMPTY_SCENE, Mesh, Scene, SceneObject
from planners.servo.question import ServoAnswer, ServoQuestion
from robot.description.model import RobotModel
from robot.processes import Child, StartedChild

log = logging.getLogger("armbridge.planners")

# The module whose main is the process.
WORKER_MODULE = "planners.worker"

# Planning gives way to the servo loop and the server, which have deadlines.
NICENESS = 5

# Cancelling takes about a millisecond; past this, native code hangs. Waits for a core come on top.
CANCEL_TIMEOUT_S = 0.25

# A process whose socket is closed is about to end; its exit code comes a moment later.
ENDING_TIMEOUT_S = 0.1

# Checks of a state or a motion take milliseconds; they have no allowed time of their own. Waits for a core come on top,
# but not where an arm moves meanwhile (planners/pool.py).
CHECK_TIME_S = 1.0

# A deadline that has been extended is looked at no sooner again: a wait for a core is counted when it has ended.
LOOK_S = 0.02

# No request holds a worker for longer, whatever it allows itself.
MAX_ALLOWED_TIME_S = 3600.0

# What packing an object costs, in terms of a mesh's bytes (which are only copied): 3 us.
OBJECT_BYTES = 8 << 10

# So much of a scene is packed within half a millisecond; the server's event loop has its turns between the parts.
PART_BYTES = 1 << 20

ANSWER_TO: Mapping[type[Request], type[Answer]] = {
    PlanningProblem: Plan,
    CartesianProblem: CartesianPlan,
    IkQuestion: IkAnswer,
    StateQuestion: StateAnswer,
    RecheckQuestion: RecheckAnswer,
    ServoQuestion: ServoAnswer,
}


class WorkerProcess:
    """A planner process.

    Args:
        robot: the arm to plan for.
        memory_limit_bytes: what it may use for data.
        on_loaded: called once with None when it is ready for requests, or with why it never will be.
        on_exit: called once when the process is gone.

    Attributes:
        loaded: whether it has ever been ready for requests.
    """

    def __init__(
        self,
        robot: RobotModel,
        memory_limit_bytes: int,
        on_loaded: Callable[[WorkerProcess, str | None], None],
        on_exit: Callable[[WorkerProcess], None],
    ) -> None:
        self._load = LoadRobot(robot, memory_limit_bytes)
        self._on_loaded = on_loaded
        self._on_exit = on_exit
        self._child = Child(StartedChild(WORKER_MODULE), self._received, self._exited, niceness=NICENESS)
        self._ending = False
        self._number = 0
        self.loaded = False
        # None stands for the process's end.
        self._answer: asyncio.Future[Any] | None = None
        # None while a scene is under way: one given up half-way is begun anew.
        self._scene_version: int | None = EMPTY_SCENE.version

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

    def run_delay_s(self) -> float | None:
        """Read for how long the process has waited for a core; see :func:`planners.budget.read_run_delay_s`."""
        return read_run_delay_s(self.pid)

    def has(self, scene: Scene) -> bool:
        """Tell whether the process has this scene."""
        return self._scene_version == scene.version

    async def ask(self, request: Request, scene: Scene) -> Answer:
        """Send a request, after the scene unless the process has it, and wait for the answer.

        The wait has no end of its own; who gives it up must :meth:`cancel` or :meth:`kill`. A process that dies, or
        answers what is none, answers CRASH.
        """
        self._number += 1
        self._answer = asyncio.get_running_loop().create_future()
        try:
            if not self.has(scene):
                await self._send_scene(scene)
            self._child.send(Ask(self._number, request))
        except ValueError as error:
            return PlanningFailure(MoveItErrorCode.FAILURE, f"the problem cannot be given to a planner: {error}")
        answer = await asyncio.shield(self._answer)
        if isinstance(answer, ANSWER_TO[type(request)] | PlanningFailure):
            return answer
        # Whatever it is worth, it must not get the next request.
        self._ending = True
        if answer is None:
            await self._child.wait(ENDING_TIMEOUT_S)
            message = f"the planner process ended ({self.ending}) while it worked on this"
        else:
            message = f"the planner answered a {type(request).__name__} with {type(answer).__name__}"
        return PlanningFailure(MoveItErrorCode.CRASH, message)

    async def cancel(self) -> None:
        """Make the process give up the request in hand, or end it when it does not listen."""
        if self._answer is None or self._scene_version is None:
            return  # the request was given up before it was sent
        self._child.send(Cancel(self._number))
        try:
            async with timeout_at(Deadline(CANCEL_TIMEOUT_S, self.run_delay_s)):
                await asyncio.shield(self._answer)
        except TimeoutError:
            log.warning("planner process %d does not listen and is ended", self.pid)
            await self.kill()

    async def kill(self) -> None:
        """End the process at once."""
        self._ending = True
        await self._child.kill()

    async def _send_scene(self, scene: Scene) -> None:
        """Send a scene in parts, between which the event loop has its turns."""
        self._scene_version = None
        self._child.send(NewScene(dataclasses.replace(scene, objects=())))
        for objects in parts(scene.objects):
            await asyncio.sleep(0)
            self._child.send(MoreObjects(objects))
        self._scene_version = scene.version

    def _received(self, message: Any) -> None:
        match message:
            case Loaded():
                self.loaded = True
                self._on_loaded(self, None)
            case LoadFailed(reason):
                self._on_loaded(self, reason)
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


@contextlib.asynccontextmanager
async def timeout_at(deadline: Deadline) -> AsyncIterator[None]:
    """Cancel the body once a deadline has passed, as :func:`asyncio.timeout` does.

    Raises:
        TimeoutError: the deadline has passed.
    """
    loop = asyncio.get_running_loop()
    looking: asyncio.TimerHandle
    async with asyncio.timeout(None) as timeout:

        def look() -> None:
            nonlocal looking
            left_s = deadline.left_s()
            if left_s > 0.0:
                looking = loop.call_later(max(left_s, LOOK_S), look)
            else:
                timeout.reschedule(loop.time())

        looking = loop.call_later(deadline.left_s(), look)
        try:
            yield
        finally:
            looking.cancel()


def parts(objects: tuple[SceneObject, ...]) -> Iterator[tuple[SceneObject, ...]]:
    """Divide objects, in their order, into parts that are quickly packed."""
    part: list[SceneObject] = []
    size = 0
    for each in objects:
        part.append(each)
        size += OBJECT_BYTES + sum(
            shape.vertices_m.nbytes + shape.triangles.nbytes for shape, _ in each.shapes if isinstance(shape, Mesh)
        )
        if size >= PART_BYTES:
            yield tuple(part)
            part, size = [], 0
    if part:
        yield tuple(part)


def allowed_time_s(request: Request) -> float:
    """Return the time that a request allows its planner, bounded [s]; the planner itself refuses what is no time."""
    match request:
        case StateQuestion() | RecheckQuestion() | ServoQuestion():
            return CHECK_TIME_S
        case _ if 0.0 <= request.allowed_time_s <= MAX_ALLOWED_TIME_S:
            return request.allowed_time_s
        case _:
            return MAX_ALLOWED_TIME_S
