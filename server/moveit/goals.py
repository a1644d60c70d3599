"""What the messages on ``/moveit_goal_*`` ask for: pure translation into the planners' goals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from planners.goals import Goal, JointGoal, PositionGoal
from planners.problem import MoveItErrorCode, PlanningFailure
from robot.model import RobotModel
from server.moveit.parameters import MoveItParameters

Message = Mapping[str, Any]


@dataclass(frozen=True)
class MotionRequest:
    """A motion somebody wants.

    Attributes:
        goal: where to.
        warnings: what was left out of account, a sentence each.
    """

    goal: Goal
    warnings: tuple[str, ...] = ()


class GoalTranslator:
    """Reads goal messages for one robot.

    Args:
        robot: the arm.
        parameters: group, link, frame and tolerances of the goals.
    """

    def __init__(self, robot: RobotModel, parameters: MoveItParameters) -> None:
        self._robot = robot
        self._parameters = parameters
        self._group = robot.groups[parameters.group_name]
        self._tip = parameters.end_effector_link or self._group.tip_link
        self._frames = {parameters.planning_frame.lstrip("/") or robot.root_link, robot.root_link}

    def named(self, message: Message) -> MotionRequest | PlanningFailure:
        """A named state of the group, from a std_msgs/String; case and blanks do not matter."""
        states = self._robot.named_states.get(self._group.name, {})
        by_key = {_key(name): name for name in states}
        name = by_key.get(_key(message["data"]))
        if name is None:
            known = ", ".join(sorted(states)) or "none"
            return _invalid(f"there is no named target {message['data']!r}; known are: {known}", known=sorted(states))
        return MotionRequest(JointGoal(dict(states[name]), self._parameters.joint_tolerance))

    def joints(self, message: Message) -> MotionRequest | PlanningFailure:
        """Joint positions, from a sensor_msgs/JointState; joints that are not named keep their position."""
        names, positions = message["name"], message["position"]
        if len(names) != len(positions):
            return _invalid(f"name has {len(names)} entries and position {len(positions)}; they must be as many")
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            return _invalid(f"the joint {repeated[0]} is named more than once")
        known = {name: value for name, value in zip(names, positions, strict=True) if name in self._group.joints}
        if not known:
            return _invalid(
                f"no joint of group {self._group.name} is named; it has {', '.join(self._group.joints)}",
                known=list(self._group.joints),
            )
        for name, value in known.items():
            if not math.isfinite(value):
                return _invalid(f"joint {name}: position must be a finite number, not {value}", joint=name)
        ignored = [name for name in names if name not in known]
        warning = f"ignored joints that are not in group {self._group.name}: {', '.join(ignored)}"
        goal = JointGoal(known, self._parameters.joint_tolerance)
        return MotionRequest(goal, (warning,) if ignored else ())

    def pose(self, message: Message) -> MotionRequest | PlanningFailure:
        """The position of a geometry_msgs/PoseStamped; five joints cannot choose an orientation as well."""
        frame = message["header"]["frame_id"].lstrip("/")
        if frame and frame not in self._frames:
            return self._unknown_frame(frame)
        point = message["pose"]["position"]
        for axis in "xyz":
            if not math.isfinite(point[axis]):
                return _invalid(f"pose.position.{axis} must be a finite number, not {point[axis]}")
        position_m = (float(point["x"]), float(point["y"]), float(point["z"]))
        return MotionRequest(PositionGoal(self._tip, position_m, self._parameters.position_tolerance))

    def _unknown_frame(self, frame: str) -> PlanningFailure:
        why = "moves with the arm" if frame in self._robot.links else "is not known"
        frames = ", ".join(sorted(self._frames))
        return PlanningFailure(
            MoveItErrorCode.FRAME_TRANSFORM_FAILURE,
            f"the frame {frame} {why}; give the pose in {frames}",
            {"frame": frame},
        )


def _key(name: str) -> str:
    return "".join(name.split()).casefold()


def _invalid(message: str, **details: Any) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, message, details)
