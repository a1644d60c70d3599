"""Planner processes, as the server sees them: one at work, one warm spare, each replaced when it dies.

The server awaits :meth:`PlannerPool.plan`; cancelling that await stops the worker, by a signal first and by force
when it does not listen. Every problem gets exactly one answer, at the latest a grace period after its allowed time.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import Coroutine
from dataclasses import dataclass, field
from typing import Any

from planners.messages import CANCEL_SIGNAL, Loaded, LoadFailed, LoadRobot, Solve, Solved
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from robot.model import RobotModel
from robot.processes import Child

log = logging.getLogger("armbridge.planners")

# A worker imports its libraries in about 1 s; a loaded machine may take several times that.
LOAD_TIMEOUT_S = 30.0

# What a worker may take beyond the allowed time to finish timing and checks before it is ended.
OVERTIME_S = 1.0

# Cooperative cancelling takes about a millisecond; past this the worker hangs in native code.
CANCEL_TIMEOUT_S = 0.25

# Planning gives way to the servo loop and the server, which have deadlines.
NICENESS = 5

# A robot that no worker can load would otherwise restart workers for ever.
MAX_FAILED_STARTS = 3


@dataclass
class _Worker:
    """One planner process and the problem in its hands."""

    child: Child
    ready: asyncio.Event = field(default_factory=asyncio.Event)
    number: int = 0
    answer: asyncio.Future[Plan | PlanningFailure] | None = None


class PlannerPool:
    """Planner processes for one robot.

    Args:
        robot: the arm to plan for.
        active: how many problems may be planned at the same time; one more process is kept as a warm spare.
    """

    def __init__(self, robot: RobotModel, active: int = 1) -> None:
        self._robot = robot
        self._active = active
        self._workers: list[_Worker] = []
        self._idle: deque[_Worker] = deque()
        self._slots = asyncio.Semaphore(active)
        self._changed = asyncio.Condition()
        self._failed_starts = 0
        self._closing = False
        self._tasks: set[asyncio.Task[None]] = set()
        self.load_failure: str | None = None

    async def start(self) -> None:
        """Start the processes; they load in the background, and problems sent meanwhile wait for them."""
        for _ in range(self._active + 1):
            await self._spawn()

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of the workers."""
        return tuple(worker.child.pid for worker in self._workers)

    @property
    def ready(self) -> bool:
        """Whether a worker is loaded."""
        return any(worker.ready.is_set() for worker in self._workers)

    async def plan(self, problem: PlanningProblem) -> Plan | PlanningFailure:
        """Plan in a worker process.

        Cancelling this call stops the planning. A worker that dies answers CRASH, one that overruns TIMED_OUT.
        """
        async with self._slots:
            worker = await self._take_worker()
            if worker is None:
                reason = self.load_failure or f"no planner process was ready within {LOAD_TIMEOUT_S:g} s"
                return PlanningFailure(MoveItErrorCode.FAILURE, f"planning is not available: {reason}")
            return await self._solve(worker, problem)

    async def close(self) -> None:
        """End every process."""
        self._closing = True
        await asyncio.gather(*(worker.child.kill() for worker in list(self._workers)))
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=1.0)

    async def _solve(self, worker: _Worker, problem: PlanningProblem) -> Plan | PlanningFailure:
        worker.number += 1
        worker.answer = asyncio.get_running_loop().create_future()
        worker.child.send(Solve(worker.number, problem))
        try:
            answer = await asyncio.wait_for(asyncio.shield(worker.answer), problem.allowed_time_s + OVERTIME_S)
        except TimeoutError:
            await self._discard(worker)
            return PlanningFailure(
                MoveItErrorCode.TIMED_OUT,
                f"the planner did not answer within {problem.allowed_time_s:g} s and was restarted",
            )
        except asyncio.CancelledError:
            # Shielded: the worker must be free or dead before its slot is, even if we are cancelled again.
            await asyncio.shield(self._in_background(self._cancel(worker)))
            raise
        if worker in self._workers:
            self._put_idle(worker)
        return answer

    async def _cancel(self, worker: _Worker) -> None:
        answer = worker.answer
        if answer is None:
            return
        worker.child.signal(CANCEL_SIGNAL)
        try:
            await asyncio.wait_for(asyncio.shield(answer), CANCEL_TIMEOUT_S)
        except TimeoutError:
            await self._discard(worker)
        else:
            if worker in self._workers:
                self._put_idle(worker)

    async def _take_worker(self) -> _Worker | None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LOAD_TIMEOUT_S), self._changed:
                await self._changed.wait_for(lambda: self._has_idle() or self.load_failure is not None)
                if self._idle:
                    return self._idle.popleft()
        return None

    def _has_idle(self) -> bool:
        """Whether a worker is idle; one that died a moment ago, its exit not yet seen, does not count."""
        while self._idle and not self._idle[0].child.running:
            self._idle.popleft()
        return bool(self._idle)

    def _put_idle(self, worker: _Worker) -> None:
        worker.answer = None
        self._idle.append(worker)
        self._in_background(self._notify())

    async def _notify(self) -> None:
        async with self._changed:
            self._changed.notify_all()

    async def _discard(self, worker: _Worker) -> None:
        """End a worker; its exit starts the replacement."""
        await worker.child.kill()

    async def _spawn(self) -> None:
        worker = _Worker(
            Child(
                "planners.worker",
                on_message=lambda message: self._received(worker, message),
                on_exit=lambda: self._exited(worker),
                niceness=NICENESS,
            )
        )
        self._workers.append(worker)
        await worker.child.connect()
        worker.child.send(LoadRobot(self._robot))

    def _received(self, worker: _Worker, message: Any) -> None:
        if isinstance(message, Loaded):
            self._failed_starts = 0
            worker.ready.set()
            self._put_idle(worker)
        elif isinstance(message, LoadFailed):
            self.load_failure = message.reason
            log.error("planner process cannot load the robot: %s", message.reason)
            self._in_background(self._notify())
        elif isinstance(message, Solved) and message.number == worker.number:
            _resolve(worker, message.answer)

    def _exited(self, worker: _Worker) -> None:
        self._workers.remove(worker)
        with contextlib.suppress(ValueError):
            self._idle.remove(worker)
        _resolve(
            worker, PlanningFailure(MoveItErrorCode.CRASH, "the planner process ended while it worked on this goal")
        )
        if self._closing:
            return
        if not worker.ready.is_set():
            self._failed_starts += 1
        if self._failed_starts >= MAX_FAILED_STARTS:
            self.load_failure = f"planner processes ended {self._failed_starts} times while starting"
            log.error("%s; no more are started", self.load_failure)
            self._in_background(self._notify())
            return
        log.warning("planner process %d ended; starting another", worker.child.pid)
        self._in_background(self._replace(worker))

    async def _replace(self, worker: _Worker) -> None:
        await worker.child.kill()
        await self._spawn()

    def _in_background(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task


def _resolve(worker: _Worker, answer: Plan | PlanningFailure) -> None:
    if worker.answer is not None and not worker.answer.done():
        worker.answer.set_result(answer)
