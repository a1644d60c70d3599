"""The arm's controller as ros2_control offers it: FollowJointTrajectory, and the topic for trajectories."""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping
from typing import Any, TypeAlias

from protocol.publication import Publication
from robot.arm import Arm
from robot.description.model import Group, RobotModel
from robot.messages import ArmState
from server.execution.current_state import CurrentState
from server.execution.motions import Motion
from server.execution.queue import GoalPolicy, GoalQueue, Progress
from server.graph.actions import Goal, GoalStatus
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.actions.controller_requests import Refused, refusal_of, tolerances_in
from server.moveit.actions.followed_goal import FollowedGoal, result
from server.moveit.actions.given_motions import given_motion

Message: TypeAlias = Mapping[str, Any]

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
        self._queue.reject(goal.action, refused.failure)
        goal.finish(GoalStatus.ABORTED, result(refused.code, refused.failure.message))

    def _take_trajectory(self, publication: Publication) -> None:
        """Play a trajectory that nobody waits for; one without points stops the arm, as ROS 1's controllers do."""
        trajectory = publication.msg
        if not trajectory["points"]:
            self._queue.cancel_all(f"stopped by an empty trajectory on {self._topic}")
            return
        refused = self._refusal(trajectory)
        if refused is not None:
            self._queue.reject(self._topic, refused.failure)
            return
        self._queue.submit(self._topic, given_motion(trajectory, self._robot), policy=GoalPolicy.PREEMPT)
