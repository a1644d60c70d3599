"""ros2_control's joint_trajectory_controller: FollowJointTrajectory, its topic for trajectories, and its state.

https://control.ros.org/master/doc/ros2_controllers/joint_trajectory_controller/doc/userdoc.html
"""

import functools
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeAlias

from planners.problem import MoveItErrorCode, PlanningFailure
from protocol.messages import Stamp
from protocol.publication import PublishedMessage
from robot.description.model import Group, RobotModel
from robot.messages import ArmState, Outcome
from robot.trajectory import Vector
from server.errors import GraphError, RefusedError, invalid_plan
from server.execution.goal import Answer, GoalPolicy, GoalRequest, GoalState, Progress, TimeLimits
from server.execution.motions import ExternalTrajectory, Positions
from server.execution.streams import MessageStream
from server.graph.actions import ActionGoal, GoalStatus
from server.graph.permissions import GOAL
from server.moveit.actions.goal_bridge import goal_status, submit_goal
from server.moveit.messages import Message
from server.moveit.requests.planning_context import GoalContext, PlanningContext
from server.moveit.requests.planning_problems import TRAJECTORY_LIMITS
from server.moveit.trajectories import TrajectoryTiming, check_speed, external_motion, read_seconds

log = logging.getLogger("armbridge.actions")

# Joint -> greatest distance [rad]. The arm's driver monitors joints that are not in it.
Tolerances: TypeAlias = Mapping[str, float]

ACTION_TYPE = "control_msgs/action/FollowJointTrajectory"
STATE_TYPE = "control_msgs/JointTrajectoryControllerState"

# Name of the same action in ROS-Industrial's drivers.
INDUSTRIAL_ACTION = "/joint_trajectory_action"

# A trajectory whose stamp is this near to now starts now: networks and clocks differ by some tens of milliseconds.
SAME_STAMP_S = 0.1

# Duration in refusals.
DURATION = "the time from now to the last point of the trajectory"

# A joint that has not arrived by then does not arrive.
MAX_GOAL_TIME_TOLERANCE_S = 10.0


class FollowCode(IntEnum):
    """Values of error_code of control_msgs/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class TrajectoryRefusedError(RefusedError):
    """A trajectory that the action rejects by an error code of its own."""

    def __init__(self, code: FollowCode, message: str) -> None:
        super().__init__(PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, message))
        self.code = code


@dataclass(frozen=True)
class SegmentTolerances:
    """Tolerances of a goal; it must be met at most ``time_s`` after the end of the motion, by the arm's clock."""

    path: Tolerances
    goal: Tolerances
    time_s: float


def checked_motion(
    message: Message, planning: PlanningContext, timing: TrajectoryTiming | None = None
) -> ExternalTrajectory:
    """Make the motion of a trajectory, and check that it can be played from where the arm is now.

    A trajectory that exceeds the arm's speed limit is refused where the settings do not have it played slower.
    """
    motion, present_rad = external_motion(message, planning.robot, timing), planning.current.positions_rad()
    if present_rad is not None:
        trajectory = motion.trajectory(present_rad, planning.clock(), None)
        if planning.parameters.configured.faster_trajectories == "refuse":
            check_speed(trajectory, planning.robot, planning.current.speed_limit(trajectory.joint_names))
    return motion


class JointTrajectoryController:
    """The actions, the topic for trajectories, and the topics of the controller's state.

    Its name stands before ``_controller``; ``industrial`` offers the action as `INDUSTRIAL_ACTION` too.
    """

    def __init__(self, context: GoalContext, group: Group, name: str, *, industrial: bool) -> None:
        self._group, self._arm, self._queue = group, context.arm, context.queue
        self._planning, self._robot = context.planning, context.planning.robot
        # Goals without result, by their number in the queue.
        self._goals: dict[str, TrajectoryGoal] = {}
        # Publishers on the topic: of the last trajectory, if it was refused, and of the last that ended, if it failed.
        self._refused: object = None
        self._failed: object = None
        self._topic = f"/{name}_controller/joint_trajectory"
        self._stream = MessageStream(self._topic)
        action = f"/{name}_controller/follow_joint_trajectory"
        node = self._node = context.graph.node(f"{group.name} controller")
        # ROS 2's name, and ROS 1's.
        self._state_topics = (f"/{name}_controller/controller_state", f"/{name}_controller/state")
        for topic in self._state_topics:
            node.advertise(topic, STATE_TYPE)
        # All fields, as a state has few of them, and is published with every state of the arm.
        self._empty = node.message_types.complete(STATE_TYPE, {}, node.message_types.now())
        for each in (action, INDUSTRIAL_ACTION) if industrial else (action,):
            node.offer_action(each, ACTION_TYPE, self._start, TRAJECTORY_LIMITS, rule=GOAL)
        type_name = "trajectory_msgs/JointTrajectory"
        node.subscribe(self._topic, type_name, self._play, limits=TRAJECTORY_LIMITS, rule=GOAL)

    def take_state(self, state: ArmState) -> None:
        """Check the tolerances of all goals against a state of the arm; publish it while there are subscribers."""
        for number, trajectory_goal in list(self._goals.items()):
            trajectory_goal.take_state(state, functools.partial(self._queue.cancel, number))
        wanted = [topic for topic in self._state_topics if self._node.subscribers(topic)]
        if wanted and (message := self._state_message(state)) is not None:
            for topic in wanted:
                self._node.publish(topic, message, prevalidated=True)

    def _state_message(self, state: ArmState) -> dict[str, Any] | None:
        if state.goal_rad is None or state.position_rad is None or state.velocity_rad_s is None:
            return None
        columns = [state.joint_names.index(name) for name in self._group.joints]
        reference, feedback = state.goal_rad[columns], state.position_rad[columns]
        empty, empty_point = self._empty, self._empty["reference"]
        return {
            **empty,
            "header": {"stamp": Stamp.from_seconds(state.stamp_s).as_message(), "frame_id": ""},
            "joint_names": list(self._group.joints),
            "reference": {**empty_point, **point(reference)},
            "feedback": {**empty_point, **point(feedback), "velocities": state.velocity_rad_s[columns].tolist()},
            "error": {**empty_point, **point(reference - feedback)},
            "speed_scaling_factor": state.pace.speed_factor,
        }

    def _start(self, goal: ActionGoal) -> None:
        try:
            tolerances = read_segment_tolerances(goal.request, self._group)
            motion = self._motion(goal.request["trajectory"], streamed=False)
        except RefusedError as error:
            self._queue.reject(GoalRequest(goal.action), error.failure)
            code = error.code if isinstance(error, TrajectoryRefusedError) else FollowCode.INVALID_GOAL
            goal.finish(GoalStatus.ABORTED, result(code, error.failure.message))
            return
        trajectory_goal = TrajectoryGoal(goal, self._group.joints, tolerances, self._robot)

        def send_feedback(progress: Progress) -> None:
            trajectory_goal.executing = progress.state is GoalState.EXECUTING
            feedback = trajectory_goal.feedback(self._arm.state)
            if feedback is not None:
                goal.feedback(feedback)

        def take_answer(answer: Answer) -> None:
            trajectory_goal.take_answer(answer, self._arm.state)

        number = submit_goal(goal, self._queue, motion, send_feedback, take_answer).goal_id
        if not goal.ended:
            self._goals[number] = trajectory_goal
            goal.when_ended(lambda _result: self._goals.pop(number))

    def _play(self, published: PublishedMessage) -> None:
        """Play a trajectory of the topic; as in ROS 1's controllers, one without points stops the arm.

        Its publisher gets every refusal, all clients get the first of several in a row: streams come at 30 Hz.
        """
        trajectory, publisher = published.msg, published.publisher
        if not trajectory["points"]:
            self._queue.cancel_all(f"stopped by an empty trajectory on {self._topic}", self._group.joints)
            return
        try:
            self._stream.check(self._arm.part(self._group.joints).last_stop)
            motion = self._motion(trajectory, streamed=True)
        except RefusedError as error:
            if publisher is not self._refused:
                self._queue.reject(GoalRequest(self._topic), error.failure)
            self._refused = publisher
            raise GraphError("topic", self._topic, error.failure.message) from error
        self._refused = None

        def take_answer(answer: Answer) -> None:
            if answer.code is not MoveItErrorCode.PREEMPTED:
                self._failed = None if answer.code is MoveItErrorCode.SUCCESS else publisher

        self._queue.submit(
            GoalRequest(
                self._topic,
                motion,
                client=publisher,
                policy=GoalPolicy.PREEMPT,
                on_answer=take_answer,
                streamed=True,
                repeated=self._failed is publisher,
            )
        )

    def _motion(self, trajectory: Message, *, streamed: bool) -> ExternalTrajectory:
        """Make the motion of a trajectory, and check that it can be played from where the arm is now."""
        planning, now_s, rate = self._planning, self._planning.clock(), self._arm.rate
        last_s = checked_duration_s(trajectory, planning.time_limits)
        starts_in_s = check_trajectory(trajectory, self._group, last_s, self._node.message_types.wall_clock())
        planning.time_limits.check_duration(starts_in_s + last_s, DURATION, MoveItErrorCode.INVALID_MOTION_PLAN)
        # A trajectory without a stamp starts at its arrival.
        stamped = abs(starts_in_s) > SAME_STAMP_S * rate
        moving = bool(self._queue.busy(self._group.joints))
        timing = TrajectoryTiming(
            now_s + starts_in_s / rate,
            stamped=stamped,
            bridged=streamed or stamped or moving,
            speed_limit=planning.current.speed_limit(self._group.joints),
            rate=rate,
        )
        return checked_motion(trajectory, planning, timing)


class TrajectoryGoal:
    """Goal of FollowJointTrajectory in the queue, with its tolerances, feedback and result."""

    def __init__(
        self, goal: ActionGoal, joints: tuple[str, ...], tolerances: SegmentTolerances, robot: RobotModel
    ) -> None:
        self._goal = goal
        self._robot = robot
        self._joints = joints
        self._tolerances = tolerances
        self.executing = False
        self._path_violation = ""
        # Set by the queue's answer when the arm must still come within the goal tolerances: end [rad], latest time [s].
        self._settling: tuple[Answer, Positions, float] | None = None

    def take_state(self, state: ArmState, cancel: Callable[[str], None]) -> None:
        if self._settling is not None:
            self._end_when_settled(state, *self._settling)
        elif self.executing and not self._path_violation and state.goal_rad is not None:
            desired_rad = dict(zip(state.joint_names, state.goal_rad.tolist(), strict=True))
            self._path_violation = violation(self._tolerances.path, state, desired_rad, self._robot)
            if self._path_violation:
                cancel(self._path_violation)

    def feedback(self, state: ArmState) -> Message | None:
        """Write the feedback message of a state of the arm; None before it moves."""
        if not self.executing or state.goal_rad is None or state.position_rad is None:
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
        """End the goal by the queue's answer, after a success as soon as the arm is within the goal tolerances."""
        self.executing = False
        if answer.code is not MoveItErrorCode.SUCCESS or not answer.performed.planned:
            self._finish(answer)
            return
        self._settling = answer, answer.performed.end_rad, state.clock_s + self._tolerances.time_s
        self._end_when_settled(state, *self._settling)

    def _end_when_settled(self, state: ArmState, answer: Answer, end_rad: Positions, until_s: float) -> None:
        if self._goal.ended:
            return
        goal_violation = violation(self._tolerances.goal, state, end_rad, self._robot)
        if not goal_violation:
            self._finish(answer)
        elif state.clock_s >= until_s:
            self._goal.finish(GoalStatus.ABORTED, result(FollowCode.GOAL_TOLERANCE_VIOLATED, goal_violation))

    def _finish(self, answer: Answer) -> None:
        if self._path_violation:
            self._goal.finish(GoalStatus.ABORTED, result(FollowCode.PATH_TOLERANCE_VIOLATED, self._path_violation))
        else:
            self._goal.finish(goal_status(answer.code), result(follow_code(answer), answer.message))


def read_segment_tolerances(goal: Message, group: Group) -> SegmentTolerances:
    path = read_tolerances(goal["path_tolerance"], "path_tolerance", group.joints)
    end = read_tolerances(goal["goal_tolerance"], "goal_tolerance", group.joints)
    time_s = read_seconds(goal["goal_time_tolerance"], "goal_time_tolerance")
    if time_s > MAX_GOAL_TIME_TOLERANCE_S:
        raise invalid_plan(f"goal_time_tolerance must be at most {MAX_GOAL_TIME_TOLERANCE_S:g} s, not {time_s:g} s")
    return SegmentTolerances(path, end, max(time_s, 0.0))


def read_tolerances(messages: Sequence[Message], field: str, joints: Sequence[str]) -> Tolerances:
    """Read tolerances: 0 is the default and a negative one is no limit; both add nothing to the driver's monitoring."""
    tolerances = {}
    for message in messages:
        name, position_rad = message["name"], message["position"]
        if name not in joints:
            raise invalid_plan(f"{field} names the joint {name!r}; the controller has {', '.join(joints)}", joint=name)
        if math.isnan(position_rad):
            raise invalid_plan(f"{field}: position of joint {name} must be a number, not nan", joint=name)
        if position_rad > 0.0:
            tolerances[name] = float(position_rad)
    return tolerances


def violation(tolerances: Tolerances, state: ArmState, desired_rad: Positions, robot: RobotModel) -> str:
    """Describe the first joint beyond its tolerance; empty if there is none."""
    if state.position_rad is None:
        return ""
    measured = dict(zip(state.joint_names, state.position_rad.tolist(), strict=True))
    for name, tolerance_rad in tolerances.items():
        error_rad = abs(measured[name] - desired_rad[name])
        if error_rad > tolerance_rad:
            unit = robot.joints[name].unit
            return (
                f"joint {name} is {error_rad:.3f} {unit} from where it should be (tolerance {tolerance_rad:g} {unit})"
            )
    return ""


def check_trajectory(trajectory: Message, group: Group, duration_s: float, now_s: float) -> float:
    """Check a trajectory's joints and time; return the time until its start by its stamp [s], 0 without a stamp.

    Raises TrajectoryRefusedError for a joint of another group, or where the motion would have ended by now.
    """
    unknown = [name for name in trajectory["joint_names"] if name not in group.joints]
    if unknown:
        text = f"trajectory.joint_names has {unknown[0]!r}; the controller has {', '.join(group.joints)}"
        raise TrajectoryRefusedError(FollowCode.INVALID_JOINTS, text)
    stamp_s = read_seconds(trajectory["header"]["stamp"], "trajectory.header.stamp")
    late_s = now_s - stamp_s - duration_s
    if stamp_s and late_s > 0.0:
        text = f"by trajectory.header.stamp the motion would have ended {late_s:.1f} s ago; the stamp 0 starts it now"
        raise TrajectoryRefusedError(FollowCode.OLD_HEADER_TIMESTAMP, text)
    return stamp_s - now_s if stamp_s else 0.0


def checked_duration_s(trajectory: Message, limits: TimeLimits) -> float:
    """Read the time of a trajectory's last point [s]; a motion that is too long takes the place of no other."""
    points = trajectory["points"]
    if not points:
        raise invalid_plan("trajectory.points is empty; to stop the arm, cancel the goal")
    field = f"trajectory.points[{len(points) - 1}].time_from_start"
    duration_s = read_seconds(points[-1]["time_from_start"], field)
    limits.check_duration(duration_s, field, MoveItErrorCode.INVALID_MOTION_PLAN)
    return duration_s


def follow_code(answer: Answer) -> FollowCode:
    if answer.code is MoveItErrorCode.SUCCESS:
        return FollowCode.SUCCESSFUL
    if answer.details.get("outcome") == Outcome.TRACKING_LOST.value:
        return FollowCode.PATH_TOLERANCE_VIOLATED
    if answer.details.get("outcome") == Outcome.NOT_SETTLED.value:
        return FollowCode.GOAL_TOLERANCE_VIOLATED
    return FollowCode.INVALID_GOAL


def result(code: FollowCode, message: str) -> Message:
    return {"error_code": int(code), "error_string": message}


def point(positions_rad: Vector) -> dict[str, Any]:
    """Write a trajectory_msgs/JointTrajectoryPoint with nothing but positions."""
    return {"positions": positions_rad.tolist()}
