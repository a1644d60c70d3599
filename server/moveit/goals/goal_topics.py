"""Goals of clients that know only topics, one a message on ``/moveit_goal_*``: how they are read, status and result."""

import json
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from planners.goals import AnyGoal, JointGoal, PoseGoal, PositionGoal
from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Pose
from protocol.errors import MessageError
from protocol.messages import ListLimits
from protocol.publication import PublishedMessage
from robot.description.model import Group, RobotModel
from server.diagnostic_values import LEVEL_ERROR, LEVEL_OK, diagnostic_status
from server.errors import RefusedError, invalid, refused
from server.execution.goal import Answer, Goal, GoalRequest, GoalState, Progress
from server.execution.motions import Joints, PlannedMotion, Positions
from server.execution.queue import GoalListener, GoalQueue
from server.graph.permissions import CANCELLING, GOAL, STOP_EVENT, STOPPING, SWITCHING, Node
from server.graph.topics import LocalNode
from server.moveit.messages import Message, composed, read_point, read_pose
from server.moveit.named_states import NamedStates
from server.moveit.parameters import MoveItParameters
from server.moveit.requests.constraints import checked_tip, chooses_orientation, planning_group, tip_link
from server.moveit.requests.planning_context import PlanningContext

log = logging.getLogger("armbridge.goals")

NAMED_TOPIC, NAMED_TYPE = "/moveit_goal_named", "std_msgs/String"
JOINTS_TOPIC, JOINTS_TYPE = "/moveit_goal_joints", "sensor_msgs/JointState"
POSE_TOPIC, POSE_TYPE = "/moveit_goal_pose", "geometry_msgs/PoseStamped"
GROUP_TOPIC, GROUP_TYPE = "/moveit_goal_group", "std_msgs/String"

# Fields of armbridge_msgs/GoalTarget, by the topic whose message each takes.
TARGET_FIELDS = {NAMED_TOPIC: "named", JOINTS_TOPIC: "joints", POSE_TOPIC: "pose"}

# Joints of one goal, and bytes of its frame; no robot comes near. Sentences quote it, and the last goals are kept.
MAX_JOINTS, MAX_GOAL_BYTES = 200, 262_144

GOAL_LIMITS = ListLimits(
    {f"sensor_msgs/msg/JointState.{field}": MAX_JOINTS for field in ("name", "position", "velocity", "effort")},
    max_bytes=MAX_GOAL_BYTES,
)

# A quaternion's length may differ from 1 by the rounding of clients that write a few digits.
UNIT_TOLERANCE = 0.01

# Points closer than this are the same in a sentence [m].
SAME_POINT_M = 1e-3


@dataclass(frozen=True)
class GoalOptions:
    """Choices of a goal for itself, in place of those selected and configured for a topic's goals."""

    group: Group | None = None
    parameters: MoveItParameters | None = None


AS_SELECTED = GoalOptions()

# Fields of armbridge_msgs/MoveitGoal that are parameters for one goal: as configured if 0 or empty.
PARAMETER_FIELDS = ("optimization", "optimization_time", "allowed_planning_time")


class GoalTranslator:
    """Translator of goal messages for one robot, or for one of several arms: the prefix of its names, its joints."""

    def __init__(
        self,
        planning: PlanningContext,
        parameters: MoveItParameters,
        states: NamedStates,
        prefix: str = "",
        only_joints: frozenset[str] | None = None,
    ) -> None:
        self._prefix = prefix
        self._only_joints = only_joints
        self.planning, self._robot = planning, planning.robot
        self._parameters = parameters
        self._states = states
        self.group = planning_group(planning.robot, "", parameters)

    @property
    def tip(self) -> str:
        """The link that pose goals are for; empty for a group that has none."""
        return tip_link(self._robot, self.group, self._parameters)

    def select_group(self, name: str) -> None:
        """Choose the planning group of goals to come; an empty name means the default."""
        self.group = self._group(name)
        if not self._prefix:
            self._states.select_group(self.group.name)

    def options(self, message: Message) -> GoalOptions:
        """Read the fields of an armbridge_msgs/MoveitGoal that choose group, speed and planning time."""
        group = self._group(message["group"]) if message["group"] else None
        chosen = {field: message[field] for field in PARAMETER_FIELDS if message[field]}
        for field in ("velocity_scaling", "acceleration_scaling"):
            value = float(message[field])
            if not 0.0 <= value <= 1.0:
                raise invalid(f"{field} must be from 0 to 1, 0 for the configured one, not {value:g}", value=value)
            if value:
                chosen[f"max_{field}"] = value
        try:
            return GoalOptions(group, self._parameters.changed(chosen))
        except ValueError as error:
            raise invalid(str(error)) from error

    def motion(self, topic: str, message: Message, options: GoalOptions = AS_SELECTED) -> PlannedMotion:
        """Translate a message of one of the three goal topics, or raise RefusedError."""
        if topic == NAMED_TOPIC:
            return self.named(message, options)
        return self.joints(message, options) if topic == JOINTS_TOPIC else self.pose(message, options)

    def named(self, message: Message, options: GoalOptions = AS_SELECTED) -> PlannedMotion:
        """Translate a std_msgs/String with the name of a state; case and blanks do not matter."""
        group = options.group or self.group
        found = self._states.find(message["data"], group.name)
        if found is None:
            names = self._states.names(group.name)
            text = f"there is no named target {message['data']!r}; known are: {', '.join(names) or 'none'}"
            nearest = self._states.nearest_name(message["data"], group.name)
            raise invalid(text, known=names, **({} if nearest is None else {"nearest_name": nearest}))
        name, positions_rad = found
        goal_rad = {joint: value for joint, value in positions_rad.items() if joint in group.joints}
        if not goal_rad:
            raise invalid(f"the named target {name!r} has no joint of group {group.name}", name=name)
        goal = JointGoal(goal_rad, self._parameters.joint_tolerance)
        return self._motion(group, goal, options)

    def joints(self, message: Message, options: GoalOptions = AS_SELECTED) -> PlannedMotion:
        """Translate a sensor_msgs/JointState; joints that are not named keep their position.

        Unless it chooses its group, the goal is one of the smallest group that has all the named joints, whatever group
        is selected.
        """
        names, positions = [self._joint(name) for name in message["name"]], message["position"]
        if len(names) != len(positions):
            raise invalid(f"name has {len(names)} entries and position {len(positions)}; they must be as many")
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise invalid(f"the joint {repeated[0]} is named more than once")
        group = options.group or self._group_of(names)
        known = {name: value for name, value in zip(names, positions, strict=True) if name in group.joints}
        if not known:
            only = f", only {', '.join(map(repr, names[:5]))}" if names else ""
            text = f"no joint of group {group.name} is named{only}; the group has {', '.join(group.joints)}"
            raise invalid(text, known=list(group.joints))
        for name, value in known.items():
            if not math.isfinite(value):
                raise invalid(f"joint {name}: position must be a finite number, not {value}", joint=name)
        ignored = [name for name in names if name not in known]
        warning = f"ignored joints that are not in group {group.name}: {', '.join(ignored)}"
        goal = JointGoal(known, self._parameters.joint_tolerance)
        return self._motion(group, goal, options, notes=(warning,) if ignored else ())

    def _group(self, name: str) -> Group:
        """Return a planning group by its name, or by its name without the arm's."""
        known = not name or name in self._robot.groups
        group = planning_group(self._robot, name if known else f"{self._prefix}{name}", self._parameters)
        self._check_own(group)
        return group

    def _check_own(self, group: Group) -> None:
        if self._only_joints is not None and not self._only_joints.issuperset(group.joints):
            text = f"group {group.name} moves other arms than {self._prefix.removesuffix('_')}"
            raise refused(MoveItErrorCode.INVALID_GROUP_NAME, text, group=group.name)

    def _joint(self, name: str) -> str:
        """Return the name of a joint in the description: messages for one arm may leave its name out."""
        return name if name in self._robot.joints else f"{self._prefix}{name}"

    def _group_of(self, names: Sequence[str]) -> Group:
        """Return the group of a joint goal: the smallest that has all of its joints, or else the selected one."""
        named = {name for name in names if name in self._robot.joints and self._robot.joints[name].movable}
        fitting = [group for group in self._robot.groups.values() if named and named <= set(group.joints)]
        return min(fitting, key=lambda group: (len(group.joints), group is not self.group), default=self.group)

    def pose(self, message: Message, options: GoalOptions = AS_SELECTED) -> PlannedMotion:
        """Translate a geometry_msgs/PoseStamped: a whole pose for six joints or more, a position for fewer.

        A frame that moves with the arm is resolved when the goal's turn comes.
        """
        frame, group = self._frame(message), options.group or self.group
        tip = checked_tip(tip_link(self._robot, group, self._parameters), group)
        radius_m, turn_rad = self._parameters.position_tolerance, self._parameters.orientation_tolerance
        goal: AnyGoal
        if chooses_orientation(group):
            goal = PoseGoal(tip, _whole_pose(message["pose"], group), radius_m, (turn_rad,) * 3, strict=True)
        else:
            goal = PositionGoal(tip, read_point(message["pose"]["position"], "pose.position"), radius_m)
        # An unknown frame is rejected at once, not when the goal's turn comes.
        present_rad = self.planning.current.positions_rad()
        if present_rad is not None:
            self.planning.frames.resolve(frame, present_rad)
        return self._motion(group, goal, options, frame)

    def pose_in_root(self, message: Message, positions_rad: Positions) -> Pose:
        """Return the whole pose of a geometry_msgs/PoseStamped in the root link."""
        pose = read_pose(message["pose"], "pose")
        return composed(self.planning.frames.resolve(self._frame(message), positions_rad), pose)

    def _frame(self, message: Message) -> str:
        frame: str = message["header"]["frame_id"] or self._parameters.planning_frame
        return frame

    def _motion(
        self, group: Group, goal: AnyGoal, options: GoalOptions, frame: str | None = None, notes: tuple[str, ...] = ()
    ) -> PlannedMotion:
        self._check_own(group)
        step = self.planning.problems.goal_step(group, goal, options.parameters, frame)
        return PlannedMotion((step,), frozenset(group.joints), warnings=notes)


def _whole_pose(message: Message, group: Group) -> Pose:
    pose = read_pose(message, "pose")
    length = math.hypot(*(message["orientation"][axis] for axis in "xyzw"))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise invalid(
            f"pose.orientation must be a unit quaternion, not one of length {length:.3g}: group {group.name} has"
            f" {len(group.joints)} joints and is brought to the whole pose; for no rotation send w = 1"
        )
    return pose


@dataclass(frozen=True)
class Suggestion:
    """Goal message that would work instead of a rejected one."""

    topic: str
    type_name: str
    msg: dict[str, Any]
    words: str

    def as_target(self) -> dict[str, Any]:
        """Return the armbridge_msgs/GoalTarget, whose one field that is given is a goal of ``/moveit_goal``."""
        return {TARGET_FIELDS[self.topic]: self.msg["data"] if self.topic == NAMED_TOPIC else self.msg}

    def added_to(self, message: str) -> str:
        return f"{message}; what would work: {self.words}"


def suggestion(message: Message, details: Mapping[str, Any], robot: RobotModel) -> Suggestion | None:
    """Return the goal to try by the details of a failure: a name, or what a plan has verified; None without one."""
    if "nearest_name" in details:
        name = details["nearest_name"]
        return Suggestion(NAMED_TOPIC, NAMED_TYPE, {"data": name}, f"the named target {name!r}")
    if "free_rad" in details:
        return _joints(details["free_rad"], robot)
    # The end of a part of a path is no goal to publish: the path must be followed up to there.
    if "free_m" in details and "free_fraction" not in details:
        found = _point(details["free_m"], message, robot.root_link)
        # The sentence of a point out of reach ends with the nearest point that can be reached.
        known_m = details.get("nearest_m") if details.get("distance_m", 0.0) > SAME_POINT_M else None
        if found is not None and known_m is not None and math.dist(details["free_m"], known_m) < SAME_POINT_M:
            return replace(found, words="that point")
        return found
    return None


def with_suggestion(message: str, details: Mapping[str, Any], robot: RobotModel) -> str:
    """Return the sentence of a failure with the goal that would work, for clients that get no details."""
    instead = suggestion({}, details, robot)
    return message if instead is None else instead.added_to(message)


def _point(position_m: list[float], message: Message, root: str) -> Suggestion | None:
    """Return the pose goal at another point, with the message's orientation; None if that is in another frame."""
    orientation = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    if "pose" in message and message["pose"]["orientation"] != orientation:
        if message["header"]["frame_id"].lstrip("/") not in ("", root):
            return None
        orientation = dict(message["pose"]["orientation"])
    x, y, z = position_m
    msg = {"header": {"frame_id": root}, "pose": {"position": {"x": x, "y": y, "z": z}, "orientation": orientation}}
    words = f"the nearest point that was found, ({x:.3f}, {y:.3f}, {z:.3f}) m"
    return Suggestion(POSE_TOPIC, POSE_TYPE, msg, words)


def _joints(positions_rad: Mapping[str, float], robot: RobotModel) -> Suggestion:
    msg = {"name": list(positions_rad), "position": list(positions_rad.values())}
    units = {robot.joints[name].unit for name in positions_rad}
    listed = ", ".join(
        f"{name} {value:.3f}" + (f" {robot.joints[name].unit}" if len(units) > 1 else "")
        for name, value in positions_rad.items()
    )
    unit = f" {units.pop()}" if len(units) == 1 else ""
    return Suggestion(JOINTS_TOPIC, JOINTS_TYPE, msg, f"the nearest configuration that was found, {listed}{unit}")


RESULT_TOPIC = "/moveit_goal_result"
STATUS_TOPIC = "/moveit_goal_status"
CANCEL_TOPIC = "/moveit_goal_cancel"
STOP_TOPIC = "/stop"
EVENT_TOPIC = "/trajectory_execution_event"


class GoalStatusTopics(GoalListener):
    """Topics for the status of all goals and the results of those on ``/moveit_goal_*``; with joints, of one arm's."""

    def __init__(self, node: LocalNode, robot: RobotModel, joints: Joints | None = None) -> None:
        self._node = node
        self._robot = robot
        self._joints = joints
        self._sources = tuple(map(node.resolve, (NAMED_TOPIC, JOINTS_TOPIC, POSE_TOPIC)))
        self._node.advertise(RESULT_TOPIC, "moveit_msgs/MoveItErrorCodes")
        self._node.advertise(STATUS_TOPIC, "diagnostic_msgs/DiagnosticStatus")

    def on_progress(self, goal: Goal, progress: Progress) -> None:
        if self._is_here(goal):
            self._publish(goal, STATUS_TOPIC, _status(goal, progress, LEVEL_OK, {}))

    def on_answer(self, goal: Goal, answer: Answer) -> None:
        """Publish the final status of a goal, then the result of a goal from a topic."""
        if not self._is_here(goal):
            return
        status = final_status(goal, answer, self._robot)
        level = logging.INFO if answer.code is MoveItErrorCode.SUCCESS else logging.WARNING
        # A goal without permission is logged where the permission is checked, and others once, as goals of all arms.
        if goal.request.only_for is None and self._joints is None and not goal.unlogged:
            fields = {"goal": goal.goal_id, "client": str(goal.request.client), "code": answer.code.name}
            sentence = "goal %s from %s: %s: %s"
            values = goal.goal_id, goal.request.source, answer.code.name, status["message"]
            log.log(level, sentence, *values, extra=fields)
        self._publish(goal, STATUS_TOPIC, status)
        if goal.request.source in self._sources:
            source = f"{goal.request.source}#{goal.goal_id}"
            self._publish(goal, RESULT_TOPIC, {"val": int(answer.code), "message": status["message"], "source": source})

    def _is_here(self, goal: Goal) -> bool:
        """Return True for a goal that moves the arm, or was sent to it and refused."""
        joints, request = self._joints, goal.request
        return joints is None or bool(request.joints & joints) or request.source.startswith(self._node.resolve("/"))

    def _publish(self, goal: Goal, topic: str, message: Mapping[str, Any]) -> None:
        # Other clients wait for the end of goals of their own.
        if goal.request.only_for is None:
            self._node.publish(topic, message)
        else:
            self._node.deliver_to(goal.request.only_for, topic, message)


def final_status(goal: Goal, answer: Answer, robot: RobotModel) -> Message:
    """Return the final status of a goal, with the goal that would have worked where one was found."""
    instead = suggestion(goal.request.message, answer.details, robot)
    message = answer.message if instead is None else instead.added_to(answer.message)
    succeeded = answer.code is MoveItErrorCode.SUCCESS
    details = {"code": str(int(answer.code)), **details_as_json(answer)}
    if instead is not None:
        # As in rosbridge's operations advertise and publish.
        suggested = {"topic": instead.topic, "type": instead.type_name, "msg": instead.msg}
        details["suggested_goal"] = json.dumps(suggested)
    done = Progress(GoalState.DONE, message, 1.0 if succeeded else 0.0)
    return _status(goal, done, LEVEL_OK if succeeded else LEVEL_ERROR, details)


def _status(goal: Goal, progress: Progress, level: int, details: Mapping[str, str]) -> Message:
    values = {
        "state": progress.state.value,
        "fraction": f"{progress.fraction:.3f}",
        "seconds_left": f"{progress.remaining_s:.2f}",
    }
    if "header" in goal.request.message:
        stamp = goal.request.message["header"]["stamp"]
        values["stamp"] = f"{stamp['sec']}.{stamp['nanosec']:09d}"
    return diagnostic_status(level, goal.request.source, progress.message, {**values, **details}, goal.goal_id)


def details_as_json(answer: Answer) -> dict[str, str]:
    return {name: json.dumps(value, default=str) for name, value in answer.details.items()}


class GoalTopics:
    """Topics by which goals are sent, their group is chosen, and they are cancelled or, of some joints, stopped."""

    def __init__(
        self, node: LocalNode, queue: GoalQueue, translator: GoalTranslator, joints: Joints | None = None
    ) -> None:
        self._node = node
        self._queue = queue
        self._translator = translator
        self._joints = joints
        for goal_topic, type_name in ((NAMED_TOPIC, NAMED_TYPE), (JOINTS_TOPIC, JOINTS_TYPE), (POSE_TOPIC, POSE_TYPE)):
            self._take_goals(goal_topic, type_name)
        self._node.advertise(GROUP_TOPIC, GROUP_TYPE, latch=True)
        self._publish_group()
        # The driving client chooses the group.
        self._node.subscribe(GROUP_TOPIC, GROUP_TYPE, self._select_group, rule=SWITCHING)
        self._node.subscribe(CANCEL_TOPIC, "std_msgs/String", self._cancel, rule=CANCELLING)
        self._node.subscribe(STOP_TOPIC, "std_msgs/Empty", self._stop, rule=STOPPING)
        self._node.subscribe(EVENT_TOPIC, "std_msgs/String", self._on_event, rule=STOP_EVENT)

    def _take_goals(self, topic: str, type_name: str) -> None:
        source = self._node.resolve(topic)

        def deliver(published: PublishedMessage) -> None:
            message = published.msg
            try:
                motion = self._translator.motion(topic, message)
            except RefusedError as error:
                self._queue.reject(GoalRequest(source, message=message), error.failure)
                return
            for warning in motion.warnings:
                log.warning("%s: %s", source, warning)
            motion = replace(motion, confirm=self._translator.planning.confirmation.enabled)
            self._queue.submit(GoalRequest(source, motion, message, published.publisher))

        def reject_invalid(error: MessageError) -> None:
            failure = PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, str(error))
            self._queue.reject(GoalRequest(source), failure)

        def reject_unauthorized(message: Message, sender: Node, reason: str) -> None:
            failure = PlanningFailure(MoveItErrorCode.CONTROL_FAILED, reason)
            self._queue.reject(GoalRequest(source, message=message, only_for=sender), failure)

        self._node.subscribe(
            topic, type_name, deliver, reject_invalid, reject_unauthorized, limits=GOAL_LIMITS, rule=GOAL
        )

    def _select_group(self, published: PublishedMessage) -> None:
        """Choose the group of later goals; publish the present group again after an unknown name."""
        if published.publisher is self._node:
            return
        try:
            self._translator.select_group(published.msg["data"])
        except RefusedError as error:
            request = GoalRequest(self._node.resolve(GROUP_TOPIC), message=published.msg)
            self._queue.reject(request, error.failure)
        self._publish_group()

    def _publish_group(self) -> None:
        self._node.publish(GROUP_TOPIC, {"data": self._translator.group.name})

    def _cancel(self, published: PublishedMessage) -> None:
        self._queue.cancel(published.msg["data"], f"cancelled by {self._node.resolve(CANCEL_TOPIC)}")

    def _stop(self, _message: object) -> None:
        self._queue.stop(f"stopped by {self._node.resolve(STOP_TOPIC)}", self._joints)

    def _on_event(self, published: PublishedMessage) -> None:
        event = published.msg["data"]
        if event == "stop":
            self._queue.stop(f"stopped by {self._node.resolve(EVENT_TOPIC)}", self._joints)
        else:
            log.warning("%s: ignored the event %r; only 'stop' is known", EVENT_TOPIC, event)
