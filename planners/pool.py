"""Planner processes, as the server sees them: some at work, one a warm spare, each replaced when it ends.

The server awaits :meth:`PlannerPool.ask`. Cancelling that await stops the worker, by a message first and by force when
it does not listen; the spare is free meanwhile. A problem that proves hard is searched by idle workers as well, until a
request needs them (:mod:`planners.race`). Every request gets exactly one answer, at the latest a grace period after its
allowed time. What a worker waits for a core comes on top, within bounds: a busy machine must not cost a warm worker.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import functools
import logging
import os
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping
from typing import Any, TypeAlias, overload

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
    StillSearching,
)
from planners.problem import (
    Answer,
    CartesianPlan,
    CartesianProblem,
    ConcurrencyQuestion,
    IkAnswer,
    IkQuestion,
    JointPathProblem,
    MoveItErrorCode,
    NearestGoalAnswer,
    NearestGoalQuestion,
    Plan,
    PlanningFailure,
    PlanningProblem,
    RecheckAnswer,
    RecheckQuestion,
    Request,
    StateAnswer,
    StateQuestion,
)
from planners.race import Race
from planners.scene import EMPTY_SCENE, Mesh, Scene, SceneObject
from planners.servo.question import ServoAnswer, ServoQuestion
from robot.description.model import RobotModel
from robot.processes import Child, DescriptorReserve, StartedChild

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
# but not where an arm moves meanwhile.
CHECK_TIME_S = 1.0

# A deadline that has been extended is checked no sooner again: a wait for a core is counted when it has ended.
DEADLINE_CHECK_S = 0.02

# No request holds a worker for longer, whatever it allows itself.
MAX_ALLOWED_TIME_S = 3600.0

# What packing an object costs, in terms of a mesh's bytes (which are only copied): 3 us.
OBJECT_BYTES = 8 << 10

# So much of a scene is packed within half a millisecond; the server's event loop has its turns between the parts.
PART_BYTES = 1 << 20

# A worker sets up 100 boxes of a scene in 9 ms, a mesh of 10 000 triangles in 20 ms, so much in 0.1 s at most. Of the
# largest scenes that takes 0.2 s, nearly as long as a cancel may take.
BRIEF_SCENE_BYTES = PART_BYTES

ANSWER_TO: Mapping[type[Request], type[Answer]] = {
    PlanningProblem: Plan,
    CartesianProblem: CartesianPlan,
    JointPathProblem: Plan,
    IkQuestion: IkAnswer,
    NearestGoalQuestion: NearestGoalAnswer,
    StateQuestion: StateAnswer,
    RecheckQuestion: RecheckAnswer,
    ConcurrencyQuestion: RecheckAnswer,
    ServoQuestion: ServoAnswer,
}

# What a worker may take beyond the allowed time, to set up a large scene or finish its checks, before it is ended.
OVERTIME_S = 1.0

# Requests of a server that wait for a worker; past these, requests come faster than they can be answered.
MAX_WAITING = 64

# A mesh scene of the arm's full shapes and 10 000 objects fits; a machine with 4 GB is left room for the rest.
MEMORY_LIMIT_BYTES = 1_024_000_000

# A worker imports its libraries in half a second; a loaded machine may take many times that.
LOAD_TIMEOUT_S = 30.0

# After so many failed starts in a row there is a pause before each further one.
MAX_FAILED_STARTS = 3
RESTART_PAUSE_S = 5.0

# Processes that were being ended when the pool closed are gone within milliseconds.
CLOSE_TIMEOUT_S = 2.0


# Called with the allowed time that is spent on a problem [s], which proves hard.
OnHard: TypeAlias = Callable[[float], None]


def ignore(_spent_s: float) -> None:
    """Let a hard problem be."""


class WorkerProcess:
    """A planner process.

    Args:
        robot: the arm to plan for.
        memory_limit_bytes: limit of its data [bytes].
        on_loaded: called once, with None when it is ready for requests, or with the reason for which it never will be.
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
        self._on_hard: OnHard = ignore
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

    async def ask(self, request: Request, scene: Scene, on_hard: OnHard = ignore) -> Answer:
        """Send a request, after the scene unless the process has it, and wait for the answer.

        The wait has no end of its own; the caller that gives it up must :meth:`cancel` or :meth:`kill`. A process that
        dies, or sends no answer to the request, answers CRASH.

        Args:
            request: the request.
            scene: to answer it in.
            on_hard: called when it is a problem that proves hard, and again each time that it has taken twice as long.
        """
        self._number += 1
        self._on_hard = on_hard
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
            async with timeout_after(CANCEL_TIMEOUT_S, self.run_delay_s):
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


@contextlib.asynccontextmanager
async def timeout_after(allowed_s: float, run_delay_s: Callable[[], float | None]) -> AsyncIterator[None]:
    """Cancel the body as :func:`asyncio.timeout` does, but not for the time that a process waits for a core.

    Args:
        allowed_s: time to the deadline if the process never waits, by the event loop's clock [s].
        run_delay_s: reads for how long the process has waited for a core; see :class:`planners.budget.Deadline`.

    Raises:
        TimeoutError: the deadline has passed.
    """
    loop = asyncio.get_running_loop()
    deadline = Deadline(allowed_s, run_delay_s, loop.time)
    timer: asyncio.TimerHandle
    async with asyncio.timeout(None) as timeout:

        def check() -> None:
            nonlocal timer
            left_s = deadline.left_s()
            if left_s > 0.0:
                timer = loop.call_later(max(left_s, DEADLINE_CHECK_S), check)
            else:
                timeout.reschedule(loop.time())

        timer = loop.call_later(deadline.left_s(), check)
        try:
            yield
        finally:
            timer.cancel()


def parts(objects: tuple[SceneObject, ...]) -> Iterator[tuple[SceneObject, ...]]:
    """Divide objects, in their order, into parts that are quickly packed."""
    part: list[SceneObject] = []
    size = 0
    for each in objects:
        part.append(each)
        size += packed_bytes(each)
        if size >= PART_BYTES:
            yield tuple(part)
            part, size = [], 0
    if part:
        yield tuple(part)


def packed_bytes(packed: SceneObject) -> int:
    """Return what packing an object costs, in terms of a mesh's bytes."""
    meshes = (shape for shape, _ in packed.shapes if isinstance(shape, Mesh))
    return OBJECT_BYTES + sum(mesh.vertices_m.nbytes + mesh.triangles.nbytes for mesh in meshes)


def brief(scene: Scene) -> bool:
    """Tell whether a worker sets up a scene soon enough to do so for a race; it does not listen meanwhile."""
    objects = (*scene.objects, *(each.object for each in scene.attached))
    return sum(map(packed_bytes, objects)) <= BRIEF_SCENE_BYTES


def allowed_time_s(request: Request) -> float:
    """Return the time that a request allows its planner, bounded [s]; the planner itself refuses what is no time."""
    match request:
        case StateQuestion() | RecheckQuestion() | ConcurrencyQuestion() | ServoQuestion():
            return CHECK_TIME_S
        case _ if 0.0 <= request.allowed_time_s <= MAX_ALLOWED_TIME_S:
            return request.allowed_time_s
        case _:
            return MAX_ALLOWED_TIME_S


class PlannerPool:
    """Planner processes for one robot.

    Args:
        robot: the arm to plan for.
        active: number of motions that may be planned at the same time. More processes are kept as warm spares; while
            they are spare they answer questions, which so never wait for motions.
        memory_limit_bytes: limit of each process's data [bytes].
        questions: number of questions that may be answered at the same time, and of the spares.
        max_waiting: number of requests that may wait for their turn.
        racing: whether idle workers search for problems that prove hard as well, as many as there are cores for.

    Attributes:
        load_failure: reason for which there is no worker and probably never will be; None as long as one may come.
        waiting_count: number of requests that wait for their turn.
    """

    def __init__(
        self,
        robot: RobotModel,
        active: int = 1,
        memory_limit_bytes: int = MEMORY_LIMIT_BYTES,
        questions: int = 1,
        max_waiting: int = MAX_WAITING,
        racing: bool = True,
    ) -> None:
        self._robot = robot
        self._size = active + questions
        self._max_waiting = max_waiting
        self._memory_limit_bytes = memory_limit_bytes
        self._workers: list[WorkerProcess] = []
        self._idle: list[WorkerProcess] = []
        self._racing = racing
        self._races: list[Race] = []
        self._motion_turns = asyncio.Semaphore(active)
        self._question_turns = asyncio.Semaphore(questions)
        # Motions that are planned as long as nothing else is to be planned.
        self._background: set[asyncio.Task[Plan | PlanningFailure]] = set()
        # Set for a moment when a worker has become idle, or load_failure known.
        self._changed = asyncio.Event()
        self._closing = asyncio.Event()
        self._failed_starts = 0
        self._ever_loaded = False
        self._robot_refused = False
        self._tasks: set[asyncio.Task[None]] = set()
        self._reserve = DescriptorReserve()
        self.load_failure: str | None = None
        self.waiting_count = 0

    async def start(self) -> None:
        """Start the processes; they load in the background, and requests sent meanwhile wait for them.

        The spare starts once another has loaded, which so has the cores for itself, as long as nothing else can plan.
        """
        for _ in range(self._size - 1):
            await self._spawn()
        self._in_background(self._spawn_spare())

    async def wait_until_loaded(self) -> str | None:
        """Wait until a worker takes requests, or it is known why none can.

        Returns:
            The reason for which no worker can plan for the robot; None where one can, or may later.
        """
        while not self._ever_loaded and self.load_failure is None and not self._closing.is_set():
            await self._changed.wait()
        return self.load_failure if self._robot_refused else None

    async def close(self) -> None:
        """End every process."""
        self._closing.set()
        self._wake_waiting()
        self._reserve.close()
        await asyncio.gather(*(worker.kill() for worker in self._workers))
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=CLOSE_TIMEOUT_S)

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids."""
        return tuple(worker.pid for worker in self._workers)

    @property
    def loaded_count(self) -> int:
        """Number of workers that have loaded the robot."""
        return sum(worker.loaded for worker in self._workers)

    @property
    def idle_count(self) -> int:
        """Number of workers that wait for a request."""
        return len(self._idle)

    # Public methods for requests.

    @overload
    async def ask(self, request: PlanningProblem | JointPathProblem, scene: Scene = ...) -> Plan | PlanningFailure: ...
    @overload
    async def ask(self, request: CartesianProblem, scene: Scene = ...) -> CartesianPlan | PlanningFailure: ...
    @overload
    async def ask(
        self, request: PlanningProblem | CartesianProblem | JointPathProblem, scene: Scene = ...
    ) -> Plan | CartesianPlan | PlanningFailure: ...
    @overload
    async def ask(self, request: IkQuestion, scene: Scene = ...) -> IkAnswer | PlanningFailure: ...
    @overload
    async def ask(self, request: NearestGoalQuestion, scene: Scene = ...) -> NearestGoalAnswer | PlanningFailure: ...
    @overload
    async def ask(self, request: StateQuestion, scene: Scene = ...) -> StateAnswer | PlanningFailure: ...
    @overload
    async def ask(
        self, request: RecheckQuestion | ConcurrencyQuestion, scene: Scene = ...
    ) -> RecheckAnswer | PlanningFailure: ...
    @overload
    async def ask(self, request: ServoQuestion, scene: Scene = ...) -> ServoAnswer | PlanningFailure: ...

    async def ask(self, request: Request, scene: Scene = EMPTY_SCENE) -> Answer:
        """Have a planner answer, in a scene.

        Cancelling this call stops the work on it. A worker that dies answers CRASH, one that overruns TIMED_OUT.
        """
        if self.waiting_count >= self._max_waiting:
            message = f"{self.waiting_count} requests wait for a planner already (limit {self._max_waiting})"
            return PlanningFailure(MoveItErrorCode.FAILURE, message)
        motion = isinstance(request, PlanningProblem | CartesianProblem | JointPathProblem | NearestGoalQuestion)
        turns = self._motion_turns if motion else self._question_turns
        if motion and turns.locked():
            for task in self._background:
                task.cancel()
        self.waiting_count += 1
        try:
            await turns.acquire()
        finally:
            self.waiting_count -= 1
        try:
            return await self._answer(request, scene)
        finally:
            turns.release()

    async def ask_in_background(
        self, problem: PlanningProblem, scene: Scene = EMPTY_SCENE
    ) -> Plan | PlanningFailure | None:
        """Have a planner plan a motion that nothing waits for, in a scene; arguments as for :meth:`ask`.

        Returns:
            None if all planners of motions are at work, or as soon as another request needs the one that plans this.
        """
        if self._motion_turns.locked():
            return None
        asking = asyncio.create_task(self.ask(problem, scene), name="planning in the background")
        self._background.add(asking)
        try:
            await asyncio.wait([asking])
        finally:
            self._background.discard(asking)
            asking.cancel()
        return None if asking.cancelled() else asking.result()

    # Private methods for requests: a worker is taken from the idle ones and put back once it has answered.

    async def _answer(self, request: Request, scene: Scene) -> Answer:
        """Answer a request whose turn it is."""
        # Where nothing waits for a motion, the workers that are idle stay so for what comes.
        if not self._racing or not isinstance(request, PlanningProblem) or asyncio.current_task() in self._background:
            return await self._have_answered(request, scene)
        race = Race(request)
        self._races.append(race)
        try:
            join = functools.partial(self._join, race, scene)
            return await race.run(self._have_answered(request, scene, join))
        finally:
            self._races.remove(race)

    async def _have_answered(self, request: Request, scene: Scene, on_hard: OnHard = ignore) -> Answer:
        """Have the next idle worker answer."""
        worker = await self._take_worker(scene)
        if worker is not None:
            return await self._work(worker, request, scene, on_hard)
        reason = self.load_failure or f"no planner process was ready within {LOAD_TIMEOUT_S:g} s"
        return PlanningFailure(MoveItErrorCode.FAILURE, f"planning is not available: {reason}")

    async def _take_worker(self, scene: Scene) -> WorkerProcess | None:
        """Wait for an idle worker, also for one that a race gives back."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LOAD_TIMEOUT_S):
                while True:
                    worker = self._take_idle(scene)
                    if worker is not None or self.load_failure is not None:
                        return worker
                    any(race.give_way() for race in self._races)
                    await self._changed.wait()
        return None

    def _take_idle(self, scene: Scene) -> WorkerProcess | None:
        """Take an idle worker, of several one that has the scene; one that died a moment ago does not count."""
        self._idle = [worker for worker in self._idle if worker.usable]
        if not self._idle:
            return None
        chosen = min(self._idle, key=lambda worker: not worker.has(scene))
        self._idle.remove(chosen)
        return chosen

    # Private methods for races: idle workers search as well.

    def _join(self, race: Race, scene: Scene, spent_s: float) -> None:
        """Have idle workers join a race, as long as each worker has a core for itself."""
        ready = sum(brief(scene) or worker.has(scene) for worker in self._idle)
        at_work = len(self._workers) - len(self._idle)
        for _ in range(min(ready, len(os.sched_getaffinity(0)) - at_work)):
            race.join(lambda problem: self._search_as_well(problem, scene), spent_s)

    async def _search_as_well(self, problem: PlanningProblem, scene: Scene) -> Answer:
        worker = self._take_idle(scene)
        if worker is None:
            return PlanningFailure(MoveItErrorCode.PREEMPTED, "another request has taken the worker")
        return await self._work(worker, problem, scene)

    async def _work(self, worker: WorkerProcess, request: Request, scene: Scene, on_hard: OnHard = ignore) -> Answer:
        allowed_s = allowed_time_s(request)
        limit_s = allowed_s + OVERTIME_S
        # An arm moves meanwhile, and stops if there is no answer: a busy machine extends no deadline here.
        while_moving = isinstance(request, RecheckQuestion | ConcurrencyQuestion | ServoQuestion)
        try:
            async with asyncio.timeout(limit_s) if while_moving else timeout_after(limit_s, worker.run_delay_s):
                answer = await worker.ask(request, scene, on_hard)
        except TimeoutError:
            # A worker that was only starved answers while it is cancelled, and so is kept.
            self._in_background(self._cancel(worker) if while_moving else worker.kill())
            return PlanningFailure(
                MoveItErrorCode.TIMED_OUT, f"the planner did not answer within {allowed_s:g} s and was given up"
            )
        except asyncio.CancelledError:
            self._in_background(self._cancel(worker))
            raise
        self._put_back(worker)
        return answer

    async def _cancel(self, worker: WorkerProcess) -> None:
        await worker.cancel()
        self._put_back(worker)

    def _put_back(self, worker: WorkerProcess) -> None:
        if worker.usable:
            self._idle.append(worker)
            self._wake_waiting()
        else:
            self._in_background(worker.kill())

    def _wake_waiting(self) -> None:
        self._changed.set()
        self._changed.clear()

    # Private methods for processes: each that ends is replaced.

    async def _spawn(self) -> None:
        with self._reserve.lent():
            worker = WorkerProcess(self._robot, self._memory_limit_bytes, self._on_loaded, self._on_exit)
        self._workers.append(worker)
        try:
            await worker.start()
        except BaseException:
            # It cannot be read, and would never be missed: the end of a channel is what reports the end of a process.
            self._workers.remove(worker)
            raise
        asyncio.get_running_loop().call_later(LOAD_TIMEOUT_S, self._end_unless_loaded, worker)

    def _end_unless_loaded(self, worker: WorkerProcess) -> None:
        if not worker.loaded and not self._closing.is_set():
            self._in_background(worker.kill())

    def _on_loaded(self, worker: WorkerProcess, refusal: str | None) -> None:
        if refusal is None:
            self._failed_starts, self._ever_loaded, self.load_failure = 0, True, None
            self._put_back(worker)
            return
        log.error("planner process cannot load the robot: %s", refusal)
        self._robot_refused, self.load_failure = True, refusal
        self._wake_waiting()

    def _on_exit(self, worker: WorkerProcess) -> None:
        self._workers.remove(worker)
        if self._closing.is_set() or self._robot_refused:
            return
        # The socket of this process, which is closed behind this call, belongs to the next one.
        asyncio.get_running_loop().call_soon(self._reserve.fill)
        if not worker.loaded:
            self._count_failed_start("ended while starting")
        self._in_background(self._replace(worker))

    async def _spawn_spare(self) -> None:
        if await self.wait_until_loaded() is None:
            await self._spawn_one()

    async def _replace(self, worker: WorkerProcess) -> None:
        await worker.kill()
        log.warning("planner process %d ended (%s); starting another", worker.pid, worker.ending)
        await self._pause_after_failed_starts()
        await self._spawn_one()

    async def _spawn_one(self) -> None:
        """Start a process, with pauses between the tries."""
        while not self._closing.is_set():
            try:
                await self._spawn()
            except Exception as error:  # noqa: BLE001 - OSError, MemoryError and others; without a next try it is missing
                self._count_failed_start(f"could not be started: {str(error) or type(error).__name__}")
                await self._pause_after_failed_starts()
            else:
                break

    async def _pause_after_failed_starts(self) -> None:
        if self._failed_starts >= MAX_FAILED_STARTS:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._closing.wait(), RESTART_PAUSE_S)

    def _count_failed_start(self, problem: str) -> None:
        self._failed_starts += 1
        if self._failed_starts < MAX_FAILED_STARTS:
            return
        message = f"planner processes {problem}, {self._failed_starts} times in a row"
        log.error("%s; the next try is in %g s", message, RESTART_PAUSE_S)
        if not self._ever_loaded:
            # Where one has loaded another will: then requests wait for it.
            self.load_failure = message
            self._wake_waiting()

    def _in_background(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
