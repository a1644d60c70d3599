"""Goal messages on ``/moveit_goal_*``: their translation into motions, and the suggestion of a goal that would work."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from planners.goals import Goal, JointGoal, PositionGoal
from planners.problem import MoveItErrorCode, PlanningFailure, PlanningProblem
from planners.scene import Pose
from robot.model import RobotModel
from server.execution.motions import PlannedMotion, Positions
from server.moveit.named_states import NamedStates
from server.moveit.parameters import MoveItParameters
from server.moveit.poses import composed, read_pose

Message: TypeAlias = Mapping[str, Any]

# Pose of a frame in the root link, for positions of the joints [rad].
Resolve: TypeAlias = Callable[[str, Positions], Pose | PlanningFailure]


NAMED_TOPIC, NAMED_TYPE = "/moveit_goal_named", "std_msgs/String"
JOINTS_TOPIC, JOINTS_TYPE = "/moveit_goal_joints", "sensor_msgs/JointState"
POSE_TOPIC, POSE_TYPE = "/moveit_goal_pose", "geometry_msgs/PoseStamped"


class GoalTranslator:
    """Reads goal messages for one robot.

    Args:
        robot: the arm.
        parameters: how goals are planned, and group, link, frame and tolerances of the goals.
        states: the named states.
        resolve: knows the frames.
        present: position of every movable joint now [rad], None while it is not known.

    Attributes:
        tip: the link that pose goals are for.
    """

    def __init__(
        self,
        robot: RobotModel,
        parameters: MoveItParameters,
        states: NamedStates,
        resolve: Resolve,
        present: Callable[[], Positions | None],
    ) -> None:
        self._parameters = parameters
        self._states = states
        self._resolve = resolve
        self._present = present
        self._group = robot.groups[parameters.group_name]
        self.tip = parameters.end_effector_link or self._group.tip_link

    def named(self, message: Message) -> PlannedMotion | PlanningFailure:
        """A named state of the group, from a std_msgs/String; case and blanks do not matter."""
        found = self._states.find(message["data"])
        if found is None:
            names = self._states.names
            text = f"there is no named target {message['data']!r}; known are: {', '.join(names) or 'none'}"
            nearest = self._states.nearest_name(message["data"])
            return _invalid(text, known=names, **({} if nearest is None else {"nearest_name": nearest}))
        name, positions_rad = found
        goal_rad = {joint: value for joint, value in positions_rad.items() if joint in self._group.joints}
        if not goal_rad:
            return _invalid(f"the named target {name!r} has no joint of group {self._group.name}", name=name)
        return self._motion(lambda _start_rad: JointGoal(goal_rad, self._parameters.joint_tolerance))

    def joints(self, message: Message) -> PlannedMotion | PlanningFailure:
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
        return self._motion(lambda _start_rad: goal, (warning,) if ignored else ())

    def pose(self, message: Message) -> PlannedMotion | PlanningFailure:
        """The position of a geometry_msgs/PoseStamped; five joints cannot choose an orientation as well.

        A frame that moves with the arm is taken where it is when the goal's turn comes.
        """
        frame = self._frame(message)
        point = message["pose"]["position"]
        for axis in "xyz":
            if not math.isfinite(point[axis]):
                return _invalid(f"pose.position.{axis} must be a finite number, not {point[axis]}")
        pose = Pose((float(point["x"]), float(point["y"]), float(point["z"])))

        def goal(start_rad: Positions) -> Goal | PlanningFailure:
            placed = self._resolve(frame, start_rad)
            if isinstance(placed, PlanningFailure):
                return placed
            return PositionGoal(self.tip, composed(placed, pose).position_m, self._parameters.position_tolerance)

        # A frame that is not known is told at once, not when the goal's turn comes.
        present_rad = self._present()
        refusal = None if present_rad is None else self._resolve(frame, present_rad)
        return refusal if isinstance(refusal, PlanningFailure) else self._motion(goal)

    def pose_in_root(self, message: Message, positions_rad: Positions) -> Pose | PlanningFailure:
        """The whole pose of a geometry_msgs/PoseStamped in the root link, for positions of the joints [rad]."""
        pose = read_pose(message["pose"], "pose")
        if isinstance(pose, PlanningFailure):
            return pose
        placed = self._resolve(self._frame(message), positions_rad)
        return placed if isinstance(placed, PlanningFailure) else composed(placed, pose)

    def _frame(self, message: Message) -> str:
        frame: str = message["header"]["frame_id"] or self._parameters.planning_frame
        return frame

    def _motion(
        self, goal: Callable[[Positions], Goal | PlanningFailure], warnings: tuple[str, ...] = ()
    ) -> PlannedMotion:
        def problem(start_rad: Positions) -> PlanningProblem | PlanningFailure:
            wanted = goal(start_rad)
            return wanted if isinstance(wanted, PlanningFailure) else self._problem(wanted, start_rad)

        return PlannedMotion((problem,), warnings=warnings)

    def _problem(self, goal: Goal, start_rad: Positions) -> PlanningProblem:
        parameters = self._parameters
        return PlanningProblem(
            group=parameters.group_name,
            start_rad=start_rad,
            goal=goal,
            velocity_scaling=parameters.max_velocity_scaling,
            acceleration_scaling=parameters.max_acceleration_scaling,
            allowed_time_s=parameters.allowed_planning_time,
            attempts=parameters.num_planning_attempts,
            planner_id=parameters.planner_id,
            optimization_time_s=parameters.optimization_time,
        )


def _invalid(message: str, **details: Any) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, message, details)


@dataclass(frozen=True)
class Suggestion:
    """A goal of the simple layer.

    Attributes:
        topic: where to publish it.
        type_name: of the topic.
        msg: the message.
        words: the goal in a sentence.
    """

    topic: str
    type_name: str
    msg: dict[str, Any]
    words: str

    def as_data(self) -> dict[str, Any]:
        """The fields of rosbridge's operations advertise and publish."""
        return {"topic": self.topic, "type": self.type_name, "msg": self.msg}


def suggestion(asked: Mapping[str, Any], details: Mapping[str, Any], robot: RobotModel) -> Suggestion | None:
    """The goal that would work, from what a refusal found; None when it found none.

    Args:
        asked: the message that was refused; empty when it could not be read.
        details: what was found, as in `planners.problem.PlanningFailure`.
        robot: the arm.
    """
    if "nearest_name" in details:
        name = details["nearest_name"]
        return Suggestion(NAMED_TOPIC, NAMED_TYPE, {"data": name}, f"the named target {name!r}")
    if "free_rad" in details:
        return _joints(details["free_rad"], "the last free configuration on the way there")
    if "free_m" in details:
        return _point(details["free_m"], robot.root_link, "the last free point on the way there")
    if "nearest_m" in details:
        return _point(details["nearest_m"], robot.root_link, "the nearest point")
    if {"joint", "lower_rad", "upper_rad"} <= details.keys() and details["joint"] in asked.get("name", ()):
        return _within_limits(asked, robot)
    return None


def _point(position_m: list[float], frame: str, what: str) -> Suggestion:
    x, y, z = position_m
    pose = {"position": {"x": x, "y": y, "z": z}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    msg = {"header": {"frame_id": frame}, "pose": pose}
    return Suggestion(POSE_TOPIC, POSE_TYPE, msg, f"{what}, ({x:.3f}, {y:.3f}, {z:.3f}) m")


def _joints(positions_rad: Mapping[str, float], what: str) -> Suggestion:
    msg = {"name": list(positions_rad), "position": list(positions_rad.values())}
    listed = ", ".join(f"{name} {position_rad:.3f}" for name, position_rad in positions_rad.items())
    return Suggestion(JOINTS_TOPIC, JOINTS_TYPE, msg, f"{what}, {listed} rad")


def _within_limits(asked: Mapping[str, Any], robot: RobotModel) -> Suggestion:
    """The joint goal with every joint within its limits."""
    known = {name: value for name, value in zip(asked["name"], asked["position"], strict=True) if name in robot.joints}
    limits = {name: (robot.joints[name].lower, robot.joints[name].upper) for name in known}
    return _joints(
        {name: min(max(known[name], low), high) for name, (low, high) in limits.items()}, "within the limits"
    )
