"""ros2_control"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeAlias

import numpy as np

from planners.problem import MoveItErrorCode, PlanningFailure
from protocol.messages import Stamp
from protocol.publication import Publication
from robot.arm import Arm
from robot.messages import ArmState, Outcome
from robot.model import Group, RobotModel
from server.action_goals import Goal, GoalStatus
from server.goal_queue import Answer, GoalPolicy, GoalQueue, GoalState, Progress
from server.graph import Graph, Subscriber
from server.moveit.actions.goal_bridge import status_of
from server.moveit.current_state import CurrentState
from server.moveit.motions import Motion, Positions
from server.moveit.requests.trajectories import given_motion
from server.node import Node

Message: TypeAlias = Mapping[str, Any]

# Joint -> greatest distance [rad]. Joints that are not named have what the arm's driver guards anyway.
Tolerances: TypeAlias = Mapping[str, float]


def tolerances_of(messages: Sequence[Message], field: str, joints: Sequence[str]) -> Tolerances | PlanningFailure:
    """Read tolerances; 0 stands for the default and a negative one for no limit, which both demand nothing here.

    Args:
        messages: control_msgs/JointTolerance.
        field: their field, for refusals.
        joints: those that can be named.
    """
    found = {}
    for message in messages:
        name, position_rad = message["name"], message["position"]
        if name not in joints:
            return _invalid(f"{field} names the joint {name!r}; the controller has {', '.join(joints)}", joint=name)
        if math.isnan(position_rad):
            return _invalid(f"{field}: position of joint {name} must be a number, not nan", joint=name)
        if position_rad > 0.0:
            found[name] = float(position_rad)
    return found


def violated(tolerances: Tolerances, state: ArmState, wanted_rad: Mapping[str, float]) -> str:
    """Which joint is too far away, in a sentence; an empty text when none is.

    Args:
        tolerances: of the joints.
        state: where they are.
        wanted_rad: where they should be [rad].
    """
    if state.position_rad is None:
        return ""
    measured = dict(zip(state.joint_names, state.position_rad.tolist(), strict=True))
    for name, tolerance_rad in tolerances.items():
        error_rad = abs(measured[name] - wanted_rad[name])
        if error_rad > tolerance_rad:
            return f"joint {name} is {error_rad:.3f} rad from where it should be (tolerance {tolerance_rad:g} rad)"
    return ""


def _invalid(message: str, **details: Any) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, message, details)


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


# Beyond this nobody waits for a joint to come nearer.
MAX_GOAL_TIME_TOLERANCE_S = 10.0


@dataclass(frozen=True)
class Refused:
    """Why a trajectory is not taken on, for the action's client and for everyone."""

    code: FollowCode
    failure: PlanningFailure


def tolerances_in(goal: Message, group: Group) -> FollowedTolerances | Refused:
    """Read the tolerances of a goal.

    Args:
        goal: of control_msgs/FollowJointTrajectory.
        group: the joints that are controlled.
    """
    found: dict[str, Tolerances] = {}
    for field in ("path_tolerance", "goal_tolerance"):
        tolerances = tolerances_of(goal[field], field, group.joints)
        if isinstance(tolerances, PlanningFailure):
            return Refused(FollowCode.INVALID_GOAL, tolerances)
        found[field] = tolerances
    time_s = _seconds(goal["goal_time_tolerance"])
    if time_s > MAX_GOAL_TIME_TOLERANCE_S:
        limit = f"goal_time_tolerance must be at most {MAX_GOAL_TIME_TOLERANCE_S:g} s, not {time_s:g} s"
        return _refused(FollowCode.INVALID_GOAL, limit)
    return FollowedTolerances(found["path_tolerance"], found["goal_tolerance"], max(time_s, 0.0))


def refusal_of(
    trajectory: Message, group: Group, robot: RobotModel, present_rad: Positions | None, now_s: float
) -> Refused | None:
    """Why a trajectory cannot be played; None when nothing speaks against it.

    Args:
        trajectory: a trajectory_msgs/JointTrajectory.
        group: the joints that are controlled.
        robot: the arm.
        present_rad: what the arm holds, None while that is not known [rad].
        now_s: wall-clock time [s].
    """
    if not trajectory["points"]:
        return _refused(FollowCode.INVALID_GOAL, "trajectory.points is empty; to stop the arm, cancel the goal")
    strange = [name for name in trajectory["joint_names"] if name not in group.joints]
    if strange:
        known = ", ".join(group.joints)
        return _refused(
            FollowCode.INVALID_JOINTS, f"trajectory.joint_names has {strange[0]!r}; the controller has {known}"
        )
    late_s = now_s - _end_s(trajectory)
    if _seconds(trajectory["header"]["stamp"]) > 0.0 and late_s > 0.0:
        return _refused(
            FollowCode.OLD_HEADER_TIMESTAMP,
            f"by trajectory.header.stamp the motion would have ended {late_s:.1f} s ago; the stamp 0 starts it now",
        )
    motion = None if present_rad is None else given_motion(trajectory, robot).trajectory(present_rad)
    if isinstance(motion, PlanningFailure):
        return Refused(FollowCode.INVALID_GOAL, motion)
    return None


def _end_s(trajectory: Message) -> float:
    """When the trajectory would end by its stamp [s since the epoch]."""
    return _seconds(trajectory["header"]["stamp"]) + _seconds(trajectory["points"][-1]["time_from_start"])


def _seconds(stamp: Message) -> float:
    return float(stamp["sec"]) + 1e-9 * float(stamp["nanosec"])


def _refused(code: FollowCode, message: str) -> Refused:
    return Refused(code, PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, message))


STATE_TYPE = "control_msgs/JointTrajectoryControllerState"


class ControllerState:
    """Publishes the topic, with every state of the arm, while somebody listens.

    Args:
        graph: where it is.
        group: the joints that are controlled.
    """

    def __init__(self, graph: Graph, group: Group) -> None:
        self._graph = graph
        self._joints = group.joints
        self._node = Node(f"{group.name} controller")
        # ROS 2's name, and ROS 1's.
        self._topics = (f"/{group.name}_controller/controller_state", f"/{group.name}_controller/state")

    def open(self) -> None:
        """Advertise it under both names."""
        for topic in self._topics:
            self._graph.advertise(self._node, topic, STATE_TYPE)

    def take_state(self, state: ArmState) -> None:
        """Publish a state of the arm."""
        message: dict[str, Any] | None = None
        for topic in self._topics:
            if self._graph.subscribers(topic):
                message = message or self._message(state)
                if message is not None:
                    self._graph.publish(self._node, topic, message)

    def _message(self, state: ArmState) -> dict[str, Any] | None:
        if state.goal_rad is None or state.position_rad is None or state.velocity_rad_s is None:
            return None
        columns = [state.joint_names.index(name) for name in self._joints]
        reference, feedback = state.goal_rad[columns], state.position_rad[columns]
        return {
            "header": {"stamp": Stamp.from_seconds(state.stamp_s).as_message(), "frame_id": ""},
            "joint_names": list(self._joints),
            "reference": point(reference),
            "feedback": {**point(feedback), "velocities": state.velocity_rad_s[columns].tolist()},
            "error": point(reference - feedback),
            "speed_scaling_factor": state.pace.speed_factor,
        }


ACTION_TYPE = "control_msgs/action/FollowJointTrajectory"

# What ROS-Industrial's drivers call the same action.
INDUSTRIAL_ACTION = "/joint_trajectory_action"


class ArmController:
    """Offers the actions and listens to the topic.

    Args:
        graph: where they are.
        robot: the arm.
        group: the joints that are controlled.
        arm: the arm.
        current: where it is.
        queue: the one way to it.
    """

    def __init__(
        self,
        graph: Graph,
        robot: RobotModel,
        group: Group,
        arm: Arm,
        current: CurrentState,
        queue: GoalQueue[Motion],
    ) -> None:
        self._graph = graph
        self._robot = robot
        self._group = group
        self._arm = arm
        self._current = current
        self._queue = queue
        self._node = Node(f"{group.name} controller")
        self.actions = (f"/{group.name}_controller/follow_joint_trajectory", INDUSTRIAL_ACTION)
        self._topic = f"/{group.name}_controller/joint_trajectory"
        # Those whose end is still to come, by their number in the queue.
        self._followed: dict[str, FollowedGoal] = {}

    def open(self) -> None:
        """Offer and subscribe."""
        for name in self.actions:
            self._graph.actions.offer(self._node, name, ACTION_TYPE, self._start)
        self._graph.subscribe(
            self._node, self._topic, "trajectory_msgs/JointTrajectory", Subscriber(self._take_trajectory)
        )

    def take_state(self, state: ArmState) -> None:
        """Hold the arm's state against the tolerances of goals on their way."""
        for number, followed in list(self._followed.items()):
            followed.take_state(state, functools.partial(self._queue.cancel, number))

    def _start(self, goal: Goal) -> None:
        demands = tolerances_in(goal.request, self._group)
        if isinstance(demands, Refused):
            self._refuse(goal, demands)
            return
        refused = self._refusal(goal.request["trajectory"])
        if refused is not None:
            self._refuse(goal, refused)
            return
        followed = FollowedGoal(goal, self._group.joints, demands)

        def tell(progress: Progress) -> None:
            followed.take_progress(progress)
            feedback = followed.feedback(self._arm.state)
            if feedback is not None:
                goal.feedback(feedback)

        number = self._queue.submit(
            goal.action,
            given_motion(goal.request["trajectory"], self._robot),
            policy=GoalPolicy.PREEMPT,
            on_progress=tell,
            on_answer=lambda answer: followed.take_answer(answer, self._arm.state),
        )
        self._followed[number] = followed
        goal.when_ended(lambda _result: self._followed.pop(number, None))
        goal.when_canceled(lambda: self._queue.cancel(number, f"cancelled by a client of {goal.action}"))

    def _refusal(self, trajectory: Message) -> Refused | None:
        return refusal_of(trajectory, self._group, self._robot, self._current.positions_rad(), time.time())

    def _refuse(self, goal: Goal, refused: Refused) -> None:
        self._queue.refuse(goal.action, refused.failure)
        goal.finish(GoalStatus.ABORTED, result(refused.code, refused.failure.message))

    def _take_trajectory(self, publication: Publication) -> None:
        """Play a trajectory that nobody waits for; one without points stops the arm, as ROS 1's controllers do."""
        trajectory = publication.msg
        if not trajectory["points"]:
            self._queue.end_all(f"stopped by an empty trajectory on {self._topic}")
            return
        refused = self._refusal(trajectory)
        if refused is not None:
            self._queue.refuse(self._topic, refused.failure)
            return
        self._queue.submit(self._topic, given_motion(trajectory, self._robot), policy=GoalPolicy.PREEMPT)
