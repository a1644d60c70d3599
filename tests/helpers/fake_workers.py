"""Planner processes in the test's own process, which answer in the event loop's time."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable

from planners.messages import LoadRobot
from planners.pool import OnHard
from planners.problem import Answer, MoveItErrorCode, Plan, PlanningFailure, PlanningProblem, Request, StateAnswer
from planners.scene import EMPTY_SCENE, Scene
from planners.worker import HARD_AFTER_S
from tests.helpers.motions import STILL

PLAN, SOUND = Plan(STILL, "first", 0.01), StateAnswer(valid=True, problems=())
TOUCHING = StateAnswer(valid=False, problems=())
CRASH = PlanningFailure(MoveItErrorCode.CRASH, "the planner process ended")
TIMED_OUT = PlanningFailure(MoveItErrorCode.TIMED_OUT, "no motion was found")

# Ends of a search, as group names: with a plan once it has proved hard; with the allowed time; with the worker's end;
# and never, whatever happens.
HARD, IN_VAIN, CRASHES, DEAF = "hard", "in vain", "crashes", "deaf"
SEARCH_S = 3.0 * HARD_AFTER_S


class FakeWorker:
    """A planner process as :class:`planners.pool.WorkerProcess` is: same constructor, same methods.

    Attributes:
        asked: requests so far, in their order.
        killed: number of times that the pool has ended it.
        listens: whether it gives up a request that is cancelled.
    """

    loaded = usable = False
    killed = 0
    listens = True
    ending = "exit code 1"

    def __init__(
        self,
        farm: Farm,
        pid: int,
        on_loaded: Callable[[FakeWorker, str | None], None],
        on_exit: Callable[[FakeWorker], None],
        *,
        urgent: bool,
    ) -> None:
        self.pid = pid
        self.urgent = urgent
        self.asked: list[Request] = []
        self._farm = farm
        self._on_loaded, self._on_exit = on_loaded, on_exit
        self._scene = EMPTY_SCENE
        self._gone = False

    async def start(self) -> None:
        if self._farm.ends_at_start:
            asyncio.get_running_loop().call_soon(self.end)
        elif self._farm.loads:
            asyncio.get_running_loop().call_later(self._farm.load_s, self._load)

    def has(self, scene: Scene) -> bool:
        return self._scene.version == scene.version

    async def ask(self, request: Request, scene: Scene, on_hard: OnHard = None) -> Answer:
        assert self.usable
        if not self.has(scene):
            self._scene = scene
        self.asked.append(request)
        if not isinstance(request, PlanningProblem):
            await asyncio.sleep(self._farm.question_s)
            return SOUND if not self._scene.objects else TOUCHING
        # Another racer's seed is not 0.
        first, _, others = request.group.partition("|")
        end = others if request.seed and others else first
        self.listens = end != DEAF
        if not self.listens:
            await asyncio.get_running_loop().create_future()
        lasts_s = {HARD: SEARCH_S, CRASHES: SEARCH_S, IN_VAIN: request.allowed_time_s}.get(end, 0.01)
        spent_s, report_s = 0.0, HARD_AFTER_S
        while report_s < lasts_s:
            await asyncio.sleep(report_s - spent_s)
            spent_s, report_s = report_s, 2.0 * report_s
            if on_hard is not None:
                on_hard(spent_s)
        await asyncio.sleep(lasts_s - spent_s)
        if end == CRASHES:
            self.end()
        return {IN_VAIN: TIMED_OUT, CRASHES: CRASH}.get(end, PLAN)

    async def cancel(self) -> None:
        await asyncio.sleep(0.001)
        if not self.listens:
            await self.kill()

    async def kill(self) -> None:
        self.killed += 1
        self.end()

    def end(self) -> None:
        """End, as a process does that crashes."""
        self.usable = False
        if not self._gone:
            self._gone = True
            self._on_exit(self)

    def _load(self) -> None:
        if not self._gone:
            self.loaded = self.usable = self._farm.refusal is None
            self._on_loaded(self, self._farm.refusal)


class Farm:
    """Workers of pools, and the template that they are copies of.

    Attributes:
        workers: all that were started.
        loads: whether a worker that starts ever loads its robot.
        refusal: reason for which workers refuse the robot; None if they load it.
        starts_fail: whether no process can be started.
        ends_at_start: whether a process ends as soon as it has started.
        load_s: time that loading takes [s].
        question_s: time that an answer to a question takes [s].
    """

    def __init__(self) -> None:
        self.workers: list[FakeWorker] = []
        self.loads = True
        self.refusal: str | None = None
        self.starts_fail = False
        self.ends_at_start = False
        self.load_s = 0.5
        self.question_s = 0.005
        self._pids = itertools.count(1)

    async def start(self) -> None:
        pass

    async def copy(self) -> None:
        if self.starts_fail:
            raise OSError("no space left on device")

    async def close(self) -> None:
        pass

    def make(
        self,
        _started: None,
        _load: LoadRobot,
        on_loaded: Callable[[FakeWorker, str | None], None],
        on_exit: Callable[[FakeWorker], None],
        *,
        urgent: bool,
    ) -> FakeWorker:
        """Make a worker, as the constructor of :class:`planners.pool.WorkerProcess` does."""
        self.workers.append(FakeWorker(self, next(self._pids), on_loaded, on_exit, urgent=urgent))
        return self.workers[-1]
