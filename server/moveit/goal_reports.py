"""What is told of a goal that was checked: the message armbridge_msgs/GoalCheck."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from planners.problem import IkAnswer, MoveItErrorCode, PlanningFailure
from planners.scene import Pose
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.trajectory import rest_to_rest
from server.moveit.motions import Positions
from server.moveit.parameters import MoveItParameters
from server.moveit.poses import matrix_of

# In place of distances and times that nobody knows.
NOT_KNOWN = -1.0


class GoalReports:
    """Writes the messages.

    Args:
        robot: the arm.
        parameters: how goals are planned.
        tip: the link that pose goals are for.
    """

    def __init__(self, robot: RobotModel, parameters: MoveItParameters, tip: str) -> None:
        self._joints = [robot.joints[name] for name in robot.groups[parameters.group_name].joints]
        self._parameters = parameters
        self._tip = tip
        self._forward = ForwardPlacements(robot)

    def report(
        self, start_rad: Positions, answer: IkAnswer | PlanningFailure, wish: Pose | PlanningFailure | None
    ) -> dict[str, Any]:
        """Tell of one goal.

        Args:
            start_rad: where the joints are [rad].
            answer: what was found.
            wish: the pose that was asked for, in the root link; None for a joint goal.
        """
        if isinstance(answer, PlanningFailure):
            return _refused(answer)
        positions_rad = answer.positions_rad[0]
        return {
            "code": int(MoveItErrorCode.SUCCESS),
            "reachable": True,
            "free": True,
            "decided": True,
            "position_error_m": answer.deviations[0].position_m,
            "orientation_error_rad": self._turned_rad(positions_rad, wish) if isinstance(wish, Pose) else 0.0,
            "duration_s": self._duration_s(start_rad, positions_rad),
            "solution": {"name": list(positions_rad), "position": list(positions_rad.values())},
        }

    def _turned_rad(self, positions_rad: Positions, wish: Pose) -> float:
        """The rotation between the tip and the wish [rad]."""
        tip = self._forward.transforms(positions_rad)[self._tip]
        turn = tip[:3, :3].T @ matrix_of(wish)[:3, :3]
        return math.acos(float(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))

    def _duration_s(self, start_rad: Positions, end_rad: Positions) -> float:
        """What the slowest joint takes when nothing is in the way [s]."""
        return max(
            rest_to_rest(
                joint.name,
                start_rad[joint.name],
                end_rad[joint.name],
                self._parameters.max_velocity_scaling * joint.max_velocity,
                self._parameters.max_acceleration_scaling * joint.max_acceleration,
            ).duration_s
            for joint in self._joints
        )


def _refused(failure: PlanningFailure) -> dict[str, Any]:
    nearest_rad: Mapping[str, float] = failure.details.get("nearest_rad", {})
    return {
        "code": int(failure.code),
        "message": failure.message,
        # What cannot be had without touching something can be reached all the same.
        "reachable": failure.code is MoveItErrorCode.GOAL_IN_COLLISION,
        "free": False,
        "decided": failure.code is not MoveItErrorCode.TIMED_OUT,
        "position_error_m": float(failure.details.get("distance_m", NOT_KNOWN)),
        "orientation_error_rad": NOT_KNOWN,
        "duration_s": NOT_KNOWN,
        "solution": {"name": list(nearest_rad), "position": list(nearest_rad.values())},
    }
