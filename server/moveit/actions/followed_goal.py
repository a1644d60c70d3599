"""One goal of FollowJointTrajectory on its way: its tolerances, its feedback and its result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeAlias

import numpy as np

from planners.problem import MoveItErrorCode
from robot.messages import ArmState, Outcome
from server.execution.queue import Answer, GoalState, Progress
from server.graph.actions import Goal, GoalStatus
from server.moveit.actions.carrying_out import status_of
from server.moveit.actions.tolerances import Tolerances, violated

Message: TypeAlias = Mapping[str, Any]


class FollowCode(IntEnum):
    """Values of error_code of control_msgs/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


@dataclass(frozen=True)
class FollowedTolerances:
    """What a goal demands besides its trajectory.

    Attributes:
        path: while it is played.
        goal: at its end.
        time_s: by which the end's may be met later, on the arm's clock [s].
    """

    path: Tolerances
    goal: Tolerances
    time_s: float


class FollowedGoal:
    """A goal that the queue has.

    Args:
        goal: the action's goal.
        joints: of the controller.
        demands: its tolerances.
    """

    def __init__(self, goal: Goal, joints: tuple[str, ...], demands: FollowedTolerances) -> None:
        self._goal = goal
        self._joints = joints
        self._demands = demands
        self._executing = False
        self._violation = ""
        self._end_rad: dict[str, float] | None = None
        self._settle_until_s: float | None = None
        self._answer: Answer | None = None

    def take_progress(self, progress: Progress) -> None:
        """Take note of some news."""
        self._executing = progress.state is GoalState.EXECUTING

    def take_state(self, state: ArmState, cancel: Callable[[str], None]) -> None:
        """Hold the arm's state against the tolerances, and tell it as feedback.

        Args:
            state: the latest.
            cancel: ends the motion, with a reason.
        """
        if self._answer is not None:
            self._look_at_end(state)
        elif self._executing and not self._violation and state.goal_rad is not None:
            wanted_rad = dict(zip(state.joint_names, state.goal_rad.tolist(), strict=True))
            self._violation = violated(self._demands.path, state, wanted_rad)
            if self._violation:
                cancel(self._violation)

    def feedback(self, state: ArmState) -> Message | None:
        """The feedback message for where the arm is; None before it moves."""
        if not self._executing or state.goal_rad is None or state.position_rad is None:
            return None
        columns = [state.joint_names.index(name) for name in self._joints]
        desired, actual = state.goal_rad[columns], state.position_rad[columns]
        return {
            "joint_names": list(self._joints),
            "desired": point(desired),
            "actual": point(actual),
            "error": point(desired - actual),
        }

    def take_answer(self, answer: Answer, state: ArmState) -> None:
        """End the goal, at once or as soon as its joints are near enough to its end."""
        self._answer, self._executing = answer, False
        performed = answer.performed
        if answer.code is not MoveItErrorCode.SUCCESS or performed is None or not performed.planned:
            self._finish("")
            return
        last = performed.planned[-1]
        self._end_rad = dict(zip(last.joint_names, last.positions_rad[-1].tolist(), strict=True))
        self._settle_until_s = state.clock_s + self._demands.time_s
        self._look_at_end(state)

    def _look_at_end(self, state: ArmState) -> None:
        if self._goal.ended or self._end_rad is None or self._settle_until_s is None:
            return
        away = violated(self._demands.goal, state, self._end_rad)
        if not away or state.clock_s >= self._settle_until_s:
            self._finish(away)

    def _finish(self, away_from_goal: str) -> None:
        answer = self._answer
        if answer is None:
            raise AssertionError("a goal without an answer is finished")
        if away_from_goal:
            self._goal.finish(GoalStatus.ABORTED, result(FollowCode.GOAL_TOLERANCE_VIOLATED, away_from_goal))
        elif self._violation:
            self._goal.finish(GoalStatus.ABORTED, result(FollowCode.PATH_TOLERANCE_VIOLATED, self._violation))
        else:
            self._goal.finish(status_of(answer.code), result(code_of(answer), answer.message))


def code_of(answer: Answer) -> FollowCode:
    """What an answer of the queue is for this action."""
    if answer.code is MoveItErrorCode.SUCCESS:
        return FollowCode.SUCCESSFUL
    if answer.details.get("outcome") == Outcome.TRACKING_LOST.value:
        return FollowCode.PATH_TOLERANCE_VIOLATED
    if answer.details.get("outcome") == Outcome.NOT_SETTLED.value:
        return FollowCode.GOAL_TOLERANCE_VIOLATED
    return FollowCode.INVALID_GOAL


def result(code: FollowCode, message: str) -> Message:
    """The result message."""
    return {"error_code": int(code), "error_string": message}


def point(positions_rad: np.ndarray) -> dict[str, Any]:
    """A trajectory_msgs/JointTrajectoryPoint of positions alone."""
    return {"positions": positions_rad.tolist()}
