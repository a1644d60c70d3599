"""Goal messages on ``/moveit_goal_*``: their translation into motions, and suggestions of goals that would work."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from planners.goals import Goal, JointGoal, PositionGoal
from planners.scene import Pose
from robot.description.model import RobotModel
from server.execution.monitors import CurrentState
from server.execution.motions import PlannedMotion, Positions
from server.moveit.named_states import NamedStates
from server.moveit.parameters import MoveItParameters
from server.moveit.poses import Message, composed, read_pose
from server.moveit.requests.error_codes import invalid
from server.moveit.requests.planning_problems import ProblemBuilder
from server.moveit.scene.frames import Frames

NAMED_TOPIC, NAMED_TYPE = "/moveit_goal_named", "std_msgs/String"
JOINTS_TOPIC, JOINTS_TYPE = "/moveit_goal_joints", "sensor_msgs/JointState"
POSE_TOPIC, POSE_TYPE = "/moveit_goal_pose", "geometry_msgs/PoseStamped"


class GoalTranslator:
    """Translator of goal messages for one robot.

    Args:
        robot: the arm.
        parameters: of planning; also group, link, frame and tolerances of the goals.
        states: the named states.
        frames: look-up of frames.
        current: the positions of the arm.
        problems: builds the goals' planning problems.

    Attributes:
        tip: the link that pose goals are for.
    """

    def __init__(
        self,
        robot: RobotModel,
        parameters: MoveItParameters,
        states: NamedStates,
        frames: Frames,
        current: CurrentState,
        problems: ProblemBuilder,
    ) -> None:
        self._parameters = parameters
        self._states = states
        self._frames = frames
        self._current = current
        self._problems = problems
        self._group = robot.groups[parameters.group_name]
        self.tip = parameters.end_effector_link or self._group.tip_link

    def named(self, message: Message) -> PlannedMotion:
        """Translate a std_msgs/String with the name of a state; case and blanks do not matter.

        Raises:
            RefusedError: there is no such state, or it has no joint of the group.
        """
        found = self._states.find(message["data"])
        if found is None:
            names = self._states.names
            text = f"there is no named target {message['data']!r}; known are: {', '.join(names) or 'none'}"
            nearest = self._states.nearest_name(message["data"])
            raise invalid(text, known=names, **({} if nearest is None else {"nearest_name": nearest}))
        name, positions_rad = found
        goal_rad = {joint: value for joint, value in positions_rad.items() if joint in self._group.joints}
        if not goal_rad:
            raise invalid(f"the named target {name!r} has no joint of group {self._group.name}", name=name)
        return self._motion(lambda _start_rad: JointGoal(goal_rad, self._parameters.joint_tolerance))

    def joints(self, message: Message) -> PlannedMotion:
        """Translate a sensor_msgs/JointState; joints that are not named keep their position.

        Raises:
            RefusedError: names and positions do not fit, or a position is not finite.
        """
        names, positions = message["name"], message["position"]
        if len(names) != len(positions):
            raise invalid(f"name has {len(names)} entries and position {len(positions)}; they must be as many")
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise invalid(f"the joint {repeated[0]} is named more than once")
        known = {name: value for name, value in zip(names, positions, strict=True) if name in self._group.joints}
        if not known:
            raise invalid(
                f"no joint of group {self._group.name} is named; it has {', '.join(self._group.joints)}",
                known=list(self._group.joints),
            )
        for name, value in known.items():
            if not math.isfinite(value):
                raise invalid(f"joint {name}: position must be a finite number, not {value}", joint=name)
        ignored = [name for name in names if name not in known]
        warning = f"ignored joints that are not in group {self._group.name}: {', '.join(ignored)}"
        goal = JointGoal(known, self._parameters.joint_tolerance)
        return self._motion(lambda _start_rad: goal, (warning,) if ignored else ())

    def pose(self, message: Message) -> PlannedMotion:
        """Translate the position of a geometry_msgs/PoseStamped; five joints cannot choose an orientation as well.

        A frame that moves with the arm is resolved when the goal's turn comes.

        Raises:
            RefusedError: a number is not finite, or there is no such frame.
        """
        frame = self._frame(message)
        point = message["pose"]["position"]
        for axis in "xyz":
            if not math.isfinite(point[axis]):
                raise invalid(f"pose.position.{axis} must be a finite number, not {point[axis]}")
        pose = Pose((float(point["x"]), float(point["y"]), float(point["z"])))

        def goal(start_rad: Positions) -> Goal:
            place = composed(self._frames.resolve(frame, start_rad), pose)
            return PositionGoal(self.tip, place.position_m, self._parameters.position_tolerance)

        # An unknown frame is rejected at once, not when the goal's turn comes.
        present_rad = self._current.positions_rad()
        if present_rad is not None:
            self._frames.resolve(frame, present_rad)
        return self._motion(goal)

    def pose_in_root(self, message: Message, positions_rad: Positions) -> Pose:
        """Return the whole pose of a geometry_msgs/PoseStamped in the root link.

        Args:
            message: the pose.
            positions_rad: of the joints, for frames that move with the arm [rad].

        Raises:
            RefusedError: a number is not finite, or there is no such frame.
        """
        pose = read_pose(message["pose"], "pose")
        return composed(self._frames.resolve(self._frame(message), positions_rad), pose)

    def _frame(self, message: Message) -> str:
        frame: str = message["header"]["frame_id"] or self._parameters.planning_frame
        return frame

    def _motion(self, goal: Callable[[Positions], Goal], warnings: tuple[str, ...] = ()) -> PlannedMotion:
        return PlannedMotion((lambda start_rad: self._problems.goal(goal(start_rad), start_rad),), warnings=warnings)


@dataclass(frozen=True)
class Suggestion:
    """Goal message that would work instead of a rejected one.

    Attributes:
        topic: of the message.
        type_name: of the topic.
        msg: the message, ready to be published.
        words: the goal in a sentence.
    """

    topic: str
    type_name: str
    msg: dict[str, Any]
    words: str

    def as_data(self) -> dict[str, Any]:
        """Return the fields of rosbridge's operations advertise and publish."""
        return {"topic": self.topic, "type": self.type_name, "msg": self.msg}


def suggestion(message: Message, details: Mapping[str, Any], robot: RobotModel) -> Suggestion | None:
    """Return the goal that would work by the details of a failure; None when they name none.

    Args:
        message: the rejected message; empty when it could not be read.
        details: as in `planners.problem.PlanningFailure`.
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
    if {"joint", "lower_rad", "upper_rad"} <= details.keys() and details["joint"] in message.get("name", ()):
        return _within_limits(message, robot)
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


def _within_limits(message: Message, robot: RobotModel) -> Suggestion:
    """Return the joint goal with every joint within its limits."""
    named = zip(message["name"], message["position"], strict=True)
    known = {name: value for name, value in named if name in robot.joints}
    limits = {name: (robot.joints[name].lower, robot.joints[name].upper) for name in known}
    return _joints(
        {name: min(max(known[name], low), high) for name, (low, high) in limits.items()}, "within the limits"
    )
