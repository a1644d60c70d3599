"""Planners as the server sees them: every request gets one answer, in turns of motions and of questions."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from typing import overload

from planners.problem import (
    Answer,
    CartesianPlan,
    CartesianProblem,
    ConcurrencyQuestion,
    IkAnswer,
    IkQuestion,
    JointPathProblem,
    MotionRequest,
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
from planners.scene import EMPTY_SCENE, Scene
from planners.servo.question import ServoAnswer, ServoQuestion

# Requests of a server that wait for a planner; past these, requests come faster than they can be answered.
MAX_WAITING = 64

# A planner process imports its libraries in half a second; a loaded machine may take many times that.
LOAD_TIMEOUT_S = 30.0


class Planners(ABC):
    """Planners of one robot, with turns for ``active`` motions and ``questions`` at a time, which others wait for."""

    def __init__(self, active: int = 1, questions: int = 1, max_waiting: int = MAX_WAITING) -> None:
        self._max_waiting = max_waiting
        self._motion_turns = asyncio.Semaphore(active)
        self._question_turns = asyncio.Semaphore(questions)
        # Reason for which there is no planner and probably never will be; None as long as one may come.
        self.load_failure: str | None = None
        self.waiting_count = 0  # requests that wait for their turn

    @abstractmethod
    async def start(self) -> None:
        """Begin to get ready; requests sent meanwhile wait."""

    @abstractmethod
    async def close(self) -> None:
        """End all that was started."""

    @abstractmethod
    async def wait_until_loaded(self) -> str | None:
        """Wait until a planner takes requests; return the reason for which none can plan for the robot, else None."""

    @property
    @abstractmethod
    def pids(self) -> tuple[int, ...]:
        """Process ids of the planners."""

    @property
    def loaded_count(self) -> int:
        """Number of processes that have loaded the robot."""
        return len(self.pids)

    @property
    @abstractmethod
    def idle_count(self) -> int:
        """Number of processes that wait for a request."""

    @abstractmethod
    async def _answer(self, request: Request, scene: Scene) -> Answer:
        """Have a request answered, whose turn it is."""

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
        """Have a planner answer, CRASH if it dies, TIMED_OUT if it overruns; cancelling this stops the work."""
        if self.waiting_count >= self._max_waiting:
            message = f"{self.waiting_count} requests wait for a planner already (limit {self._max_waiting})"
            return PlanningFailure(MoveItErrorCode.FAILURE, message)
        turns = self._motion_turns if isinstance(request, MotionRequest) else self._question_turns
        self.waiting_count += 1
        try:
            await turns.acquire()
        finally:
            self.waiting_count -= 1
        try:
            return await self._answer(request, scene)
        finally:
            turns.release()
