"""Planners, as the server sees them: planner processes here, one of them a warm spare, and workers that join from afar.

The server awaits :meth:`PlannerPool.ask`. Cancelling that await stops the worker, by a message first and by force when
it does not listen; the spare is free meanwhile. Every request gets exactly one answer, at the latest a grace period
after its allowed time. What a worker of this machine waits for a core comes on top, within bounds: a busy machine must
not cost a warm worker.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import time
from collections.abc import Coroutine
from typing import Any, overload

from planners import local_workers
from planners.budget import Deadline
from planners.local_workers import CLOSE_TIMEOUT_S, LocalWorkers
from planners.places import Places
from planners.planning_worker import PlanningWorker
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
from planners.scene import EMPTY_SCENE, Scene
from planners.servo.question import ServoAnswer, ServoQuestion
from planners.worker_process import allowed_time_s, timeout_at
from robot.description.model import RobotModel

# What a worker may take beyond the allowed time, to set up a large scene or finish its checks, before it is ended.
OVERTIME_S = 1.0

# Requests that wait for a worker; past these a client asks faster than can be answered.
MAX_WAITING = 64

# A mesh scene of the arm's full shapes and 10 000 objects fits; a machine with 4 GB is left room for the rest.
MEMORY_LIMIT_BYTES = 1_024_000_000


class PlannerPool:
    """Planners for one robot.

    Args:
        robot: the arm to plan for.
        active: how many motions may be planned at the same time by processes of this machine. One more process is kept
            as a warm spare; while it is spare it answers questions, which so never wait for motions.
        memory_limit_bytes: what each process may use for data.
    """

    def __init__(self, robot: RobotModel, active: int = 1, memory_limit_bytes: int = MEMORY_LIMIT_BYTES) -> None:
        self._active = active
        self._local = LocalWorkers(robot, active + 1, memory_limit_bytes, self._put_back, self._wake_waiting)
        self._idle: list[PlanningWorker] = []
        self._far: set[PlanningWorker] = set()
        self._motion_places = Places(active)
        self._question_places = Places(1)
        self._near_motions = 0
        self._changed = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Start the processes; they load in the background, and requests sent meanwhile wait for them."""
        await self._local.start()

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of the workers of this machine."""
        return self._local.pids

    @property
    def idle_count(self) -> int:
        """How many workers wait for a request."""
        return len(self._idle)

    @property
    def load_failure(self) -> str | None:
        """Why no process of this machine can plan for the robot; None as long as one may."""
        return self._local.load_failure

    def add(self, worker: PlanningWorker) -> None:
        """Take in a worker that takes no questions: so one more motion may be planned at the same time."""
        self._far.add(worker)
        self._motion_places.add()
        self._put_back(worker)

    def remove(self, worker: PlanningWorker) -> None:
        """Give work to a worker no more; the request in its hands is still its own to answer."""
        self._far.remove(worker)
        self._motion_places.remove()
        if worker in self._idle:
            self._idle.remove(worker)

    async def wait_ready(self, timeout_s: float) -> str | None:
        """Wait until a worker is ready for requests.

        Returns:
            Why there is none after ``timeout_s``, or probably never will be; None when there is one.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while not self._idle and self.load_failure is None:
                    await self._changed.wait()
        except TimeoutError:
            return f"no planner process was ready within {timeout_s:g} s"
        return self.load_failure

    @property
    def loaded_count(self) -> int:
        """How many workers of this machine have loaded the robot."""
        return self._local.loaded_count

    @property
    def far_count(self) -> int:
        """How many workers there are elsewhere."""
        return len(self._far)

    @property
    def waiting_count(self) -> int:
        """How many requests wait for a worker."""
        return self._motion_places.waiting + self._question_places.waiting

    @overload
    async def ask(self, request: PlanningProblem, scene: Scene = ...) -> Plan | PlanningFailure: ...
    @overload
    async def ask(self, request: CartesianProblem, scene: Scene = ...) -> CartesianPlan | PlanningFailure: ...
    @overload
    async def ask(
        self, request: PlanningProblem | CartesianProblem, scene: Scene = ...
    ) -> Plan | CartesianPlan | PlanningFailure: ...
    @overload
    async def ask(self, request: IkQuestion, scene: Scene = ...) -> IkAnswer | PlanningFailure: ...
    @overload
    async def ask(self, request: StateQuestion, scene: Scene = ...) -> StateAnswer | PlanningFailure: ...
    @overload
    async def ask(self, request: RecheckQuestion, scene: Scene = ...) -> RecheckAnswer | PlanningFailure: ...
    @overload
    async def ask(self, request: ServoQuestion, scene: Scene = ...) -> ServoAnswer | PlanningFailure: ...

    async def ask(self, request: Request, scene: Scene = EMPTY_SCENE) -> Answer:
        """Have a planner answer, in a scene.

        Cancelling this call stops the work on it. A worker that dies answers CRASH, one that overruns TIMED_OUT. A
        motion whose worker came out of reach is given to another one, once, for what is left of its allowed time.
        """
        waiting = self.waiting_count
        if waiting >= MAX_WAITING:
            message = f"{waiting} requests wait for a planner already (limit {MAX_WAITING})"
            return PlanningFailure(MoveItErrorCode.FAILURE, message)
        answer, spent_s = await self._ask_one(request, scene)
        if _out_of_reach(answer) and isinstance(request, PlanningProblem | CartesianProblem):
            left_s = allowed_time_s(request) - spent_s
            if left_s > 0.0:
                answer, _ = await self._ask_one(dataclasses.replace(request, allowed_time_s=left_s), scene)
        return answer

    async def close(self) -> None:
        """End every process."""
        await self._local.close()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=CLOSE_TIMEOUT_S)

    async def _ask_one(self, request: Request, scene: Scene) -> tuple[Answer, float]:
        """Have one worker answer; tells also for how long it has worked [s]."""
        motion = isinstance(request, PlanningProblem | CartesianProblem)
        async with (self._motion_places if motion else self._question_places).held():
            worker = await self._take_worker(scene, motion=motion)
            if worker is None:
                reason = self.load_failure or f"no planner process was ready within {local_workers.LOAD_TIMEOUT_S:g} s"
                return PlanningFailure(MoveItErrorCode.FAILURE, f"planning is not available: {reason}"), 0.0
            near_motion = motion and worker.takes_questions
            self._near_motions += near_motion
            began_s = time.monotonic()
            try:
                return await self._work(worker, request, scene), time.monotonic() - began_s
            finally:
                self._near_motions -= near_motion

    async def _work(self, worker: PlanningWorker, request: Request, scene: Scene) -> Answer:
        allowed_s = allowed_time_s(request)
        limit_s = allowed_s + OVERTIME_S
        # An arm moves while these are asked, and rests when there is no answer: here a busy machine is no excuse.
        while_moving = isinstance(request, RecheckQuestion | ServoQuestion)
        try:
            async with asyncio.timeout(limit_s) if while_moving else timeout_at(Deadline(limit_s, worker.run_delay_s)):
                answer = await worker.ask(request, scene)
        except TimeoutError:
            # A worker that was only starved answers while it is cancelled, and so is kept.
            self._in_background(self._cancel(worker) if while_moving else self._end(worker))
            return PlanningFailure(
                MoveItErrorCode.TIMED_OUT, f"the planner did not answer within {allowed_s:g} s and was given up"
            )
        except asyncio.CancelledError:
            self._in_background(self._cancel(worker))
            raise
        self._put_back(worker)
        return answer

    async def _cancel(self, worker: PlanningWorker) -> None:
        await worker.cancel()
        self._put_back(worker)

    async def _end(self, worker: PlanningWorker) -> None:
        await worker.kill()
        if worker.usable:
            self._put_back(worker)

    async def _take_worker(self, scene: Scene, *, motion: bool) -> PlanningWorker | None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(local_workers.LOAD_TIMEOUT_S):
                while (worker := self._pick(scene, motion=motion)) is None and self.load_failure is None:
                    await self._changed.wait()
                return worker
        return None

    def _pick(self, scene: Scene, *, motion: bool) -> PlanningWorker | None:
        """An idle worker, the nearest first, then one that has the scene; one that died a moment ago does not count.

        Motions leave the last worker that takes questions to them.
        """
        self._idle = [worker for worker in self._idle if worker.usable]
        near = not motion or self._near_motions < self._active
        far = motion
        suited = [worker for worker in self._idle if (near if worker.takes_questions else far)]
        if not suited:
            return None
        chosen = min(suited, key=lambda worker: (not worker.takes_questions, not worker.has(scene)))
        self._idle.remove(chosen)
        return chosen

    def _put_back(self, worker: PlanningWorker) -> None:
        if not worker.takes_questions and worker not in self._far:
            return
        if worker.usable:
            self._idle.append(worker)
            self._wake_waiting()
        else:
            self._in_background(worker.kill())

    def _wake_waiting(self) -> None:
        self._changed.set()
        self._changed.clear()

    def _in_background(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def _out_of_reach(answer: Answer) -> bool:
    return isinstance(answer, PlanningFailure) and answer.code is MoveItErrorCode.COMMUNICATION_FAILURE
