"""Planner processes of one server: some at work, one a warm spare, each replaced when it ends.

The server awaits :meth:`PlannerPool.ask`. Cancelling that await stops the worker, by a message first, else by force. A
problem that takes longer than most is searched by idle workers too, until a request needs them (:mod:`planners.race`).
Every request gets exactly one answer, at the latest a grace period after its allowed time.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import os
from collections.abc import Callable, Coroutine
from typing import Any, TypeAlias

from planners.interface import LOAD_TIMEOUT_S, MAX_WAITING, Planners
from planners.messages import (
    PART_BYTES,
    Answered,
    Ask,
    Cancel,
    Loaded,
    LoadFailed,
    LoadRobot,
    SceneSender,
    StillSearching,
    packed_bytes,
)
from planners.problem import (
    ANSWER_TO,
    Answer,
    MoveItErrorCode,
    MovingRequest,
    PlanningFailure,
    PlanningProblem,
    Request,
    StateQuestion,
    TimedRequest,
)
from planners.race import Race
from planners.scene import Scene
from robot.description.model import RobotModel
from robot.processes import ENDING_TIMEOUT_S, Child, DescriptorReserve, StartedCopy, Template

log = logging.getLogger("armbridge.planners")

WORKER_MODULE = "planners.worker"  # the module whose main is the process

# Planning gives way to the servo loop and the server, which have deadlines. Answers that a moving arm waits for do not.
NICENESS = 5

# Cancelling takes about a millisecond; past this, native code hangs. Among 12 other programs a worker waited for a core
# for 50 ms at most.
CANCEL_TIMEOUT_S = 1.0

# Checks take milliseconds and have no allowed time of their own. An arm that moves waits for CHECK_TIME_S at most. A
# question about a state may wait: the first one among 600 boxes took 2 s beside a dozen busy processes.
CHECK_TIME_S = 1.0
STATE_TIME_S = 10.0
MAX_ALLOWED_TIME_S = 3600.0  # no request holds a worker for longer, whatever it allows itself

# Size of a scene that a worker sets up in 0.1 s at most: 100 boxes take 9 ms, a mesh of 10 000 triangles 20 ms. The
# largest scenes take 0.2 s, nearly as long as a cancel may take.
BRIEF_SCENE_BYTES = PART_BYTES

# Time beyond the allowed time after which a worker is given up: it may set up a large scene or finish its checks.
OVERTIME_S = 1.0

# A mesh scene of the arm's full shapes and 10 000 objects fits; a machine with 4 GB is left room for the rest.
MEMORY_LIMIT_BYTES = 1_024_000_000

TEMPLATE_TIMEOUT_S = 4.0 * LOAD_TIMEOUT_S  # a machine is starved; a killed load would begin again

# Failed starts in a row after which there is a pause before each further one.
MAX_FAILED_STARTS = 3
RESTART_PAUSE_S = 5.0

CLOSE_TIMEOUT_S = 2.0  # processes that were being ended when the pool closed are gone within milliseconds

# Called with the allowed time that a problem has taken [s] when this is longer than most take.
OnHard: TypeAlias = Callable[[float], None] | None


class WorkerProcess:
    """A planner process; it is ``loaded`` once it has ever been ready for requests.

    An ``urgent`` process has normal priority. ``on_loaded`` is called once, with None when it is ready for requests, or
    with the reason for which it never will be; ``on_exit`` once when the process is gone.
    """

    def __init__(
        self,
        started: StartedCopy,
        load: LoadRobot,
        on_loaded: Callable[[WorkerProcess, str | None], None],
        on_exit: Callable[[WorkerProcess], None],
        *,
        urgent: bool = False,
    ) -> None:
        self.urgent = urgent
        self._load = load
        self._on_loaded = on_loaded
        self._on_exit = on_exit
        self._child = Child(started, self._received, self._exited, niceness=0 if urgent else NICENESS)
        self._ending = False
        self._number = 0
        self.loaded = False
        # None stands for the process's end.
        self._answer: asyncio.Future[Any] | None = None
        self._on_hard: OnHard = None
        self._scenes = SceneSender(self._child.send, functools.partial(asyncio.sleep, 0))

    async def start(self) -> None:
        """Give the process its robot."""
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

    async def ask(self, request: Request, scene: Scene, on_hard: OnHard = None) -> Answer:
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
            case StillSearching(number, spent_s) if number == self._number and self._on_hard is not None:
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


def allowed_time_s(request: Request) -> float:
    """Return the time that a request allows its planner, bounded [s]; the planner itself refuses an invalid time."""
    if isinstance(request, StateQuestion):
        return STATE_TIME_S
    if not isinstance(request, TimedRequest):
        return CHECK_TIME_S
    return request.allowed_time_s if 0.0 <= request.allowed_time_s <= MAX_ALLOWED_TIME_S else MAX_ALLOWED_TIME_S


class PlannerPool(Planners):
    """Planner processes for one robot: some for motions, and as many warm spares as there may be questions.

    Spares answer questions, which so never wait for motions. One spare has normal priority, and answers while an arm
    moves. Each process has a limit of its data [bytes]. With ``racing`` idle workers join long searches, one a core.
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
        super().__init__(active, questions, max_waiting)
        self._size = active + questions
        self._load = LoadRobot(robot, memory_limit_bytes)
        self._workers: list[WorkerProcess] = []
        self._idle: list[WorkerProcess] = []
        self._racing = racing
        self._races: list[Race] = []
        # Set for a moment when a worker has become idle, or load_failure known.
        self._changed = asyncio.Event()
        self._closing = asyncio.Event()
        self._failed_starts = 0
        self._ever_loaded = False
        self._robot_refused = False
        self._tasks: set[asyncio.Task[None]] = set()
        self._reserve = DescriptorReserve()
        self._template = Template(WORKER_MODULE, self._load, self._reserve, TEMPLATE_TIMEOUT_S)

    async def start(self) -> None:
        """Start the process that the workers are copies of, which loads in the background."""
        await self._template.start()
        self._in_background(self._spawn_all())

    async def wait_until_loaded(self) -> str | None:
        """Wait for the first worker that takes requests; see :class:`Planners`."""
        while not self._ever_loaded and self.load_failure is None and not self._closing.is_set():
            await self._changed.wait()
        return self.load_failure if self._robot_refused else None

    async def close(self) -> None:
        """End every process."""
        self._closing.set()
        self._wake_waiting()
        self._reserve.close()
        await asyncio.gather(*(worker.kill() for worker in self._workers))
        await self._template.close()
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

    # Private methods for requests: a worker is taken from the idle ones and put back once it has answered.

    async def _answer(self, request: Request, scene: Scene) -> Answer:
        # Where nothing waits for a motion, the workers that are idle stay so for what comes.
        if not self._racing or not isinstance(request, PlanningProblem):
            return await self._have_answered(request, scene)
        race = Race(request)
        self._races.append(race)
        try:
            join = functools.partial(self._join, race, scene)
            return await race.run(self._have_answered(request, scene, join))
        finally:
            self._races.remove(race)

    async def _have_answered(self, request: Request, scene: Scene, on_hard: OnHard = None) -> Answer:
        """Have the next idle worker answer."""
        worker = await self._take_worker(scene, urgent=isinstance(request, MovingRequest))
        if worker is not None:
            return await self._work(worker, request, scene, on_hard)
        reason = self.load_failure or f"no planner process was ready within {LOAD_TIMEOUT_S:g} s"
        return PlanningFailure(MoveItErrorCode.FAILURE, f"planning is not available: {reason}")

    async def _take_worker(self, scene: Scene, *, urgent: bool) -> WorkerProcess | None:
        """Wait for an idle worker, which may be a worker that a race gives back."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LOAD_TIMEOUT_S):
                while True:
                    worker = self._take_idle(scene, urgent=urgent)
                    if worker is not None or self.load_failure is not None:
                        return worker
                    any(race.give_way() for race in self._races)
                    await self._changed.wait()
        return None

    def _take_idle(self, scene: Scene, *, urgent: bool = False) -> WorkerProcess | None:
        """Take an idle worker that has not died: of normal priority for a moving arm, preferably with the scene."""
        self._idle = [worker for worker in self._idle if worker.usable]
        if not self._idle:
            return None
        chosen = min(self._idle, key=lambda worker: (worker.urgent is not urgent, not worker.has(scene)))
        self._idle.remove(chosen)
        return chosen

    # Private methods for races: idle workers search as well.

    def _join(self, race: Race, scene: Scene, spent_s: float) -> None:
        """Have idle workers join a race, as long as each worker has a core for itself."""
        # A worker does not listen while it sets up a scene.
        brief = sum(map(packed_bytes, scene.all_objects())) <= BRIEF_SCENE_BYTES
        ready = sum(brief or worker.has(scene) for worker in self._idle)
        at_work = len(self._workers) - len(self._idle)
        for _ in range(min(ready, len(os.sched_getaffinity(0)) - at_work)):
            race.join(lambda problem: self._search_as_well(problem, scene), spent_s)

    async def _search_as_well(self, problem: PlanningProblem, scene: Scene) -> Answer:
        worker = self._take_idle(scene)
        if worker is None:
            return PlanningFailure(MoveItErrorCode.PREEMPTED, "another request has taken the worker")
        return await self._work(worker, problem, scene)

    async def _work(self, worker: WorkerProcess, request: Request, scene: Scene, on_hard: OnHard = None) -> Answer:
        allowed_s = allowed_time_s(request)
        try:
            async with asyncio.timeout(allowed_s + OVERTIME_S):
                answer = await worker.ask(request, scene, on_hard)
        except TimeoutError:
            # A worker that was only starved answers while it is cancelled, and so is kept.
            self._in_background(self._cancel(worker))
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

    async def _spawn(self, *, urgent: bool) -> None:
        worker = WorkerProcess(await self._template.copy(), self._load, self._on_loaded, self._on_exit, urgent=urgent)
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
        self._idle = [each for each in self._idle if each is not worker]
        if self._closing.is_set() or self._robot_refused:
            return
        # The socket of this process, which is closed behind this call, belongs to the next one.
        asyncio.get_running_loop().call_soon(self._reserve.fill)
        if not worker.loaded:
            self._count_failed_start("ended while starting")
        self._in_background(self._replace(worker))

    async def _spawn_all(self) -> None:
        await self._spawn_one(urgent=False)
        # Where the first refuses the robot, so would the others.
        if await self.wait_until_loaded() is None:
            for number in range(1, self._size):
                await self._spawn_one(urgent=number == self._size - 1)

    async def _replace(self, worker: WorkerProcess) -> None:
        await worker.kill()
        log.warning("planner process %d ended (%s); starting another", worker.pid, worker.ending)
        await self._pause_after_failed_starts()
        await self._spawn_one(urgent=worker.urgent)

    async def _spawn_one(self, *, urgent: bool) -> None:
        while not self._closing.is_set():
            try:
                await self._spawn(urgent=urgent)
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
