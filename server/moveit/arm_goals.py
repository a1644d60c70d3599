"""Goals of one of several arms, by topics, services and actions below its name.

They go into the queue of all arms, in which goals of different arms run at the same time.
"""

from __future__ import annotations

from dataclasses import dataclass

from robot.arm_interface import ArmInterface
from robot.description.model import RobotModel
from robot.messages import ArmState
from server.execution.motions import Motion
from server.execution.motions_in_progress import MotionsInProgress
from server.execution.queue import Answer, GoalQueue, Progress, QueuedGoal, RunningGoal
from server.execution.time_limits import TimeLimits
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.actions.joint_trajectory_controller import ControllerStatePublisher, JointTrajectoryController
from server.moveit.goal_calls import NAME as GOAL_ACTION
from server.moveit.goal_calls import GoalCalls
from server.moveit.goal_messages import GoalTranslator, OneArm
from server.moveit.goal_topics import Confirmation, GoalStatusTopics, GoalTopics
from server.moveit.gripper import FETCH_ACTION, GRIPPER_ACTION, PARALLEL_ACTION, Gripper, GripperActions
from server.moveit.named_states import NamedStates
from server.moveit.parameters import MoveItParameters
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.servo.servo_node import ServoNode, servo_setup
from server.teleop.session import Follower


@dataclass(frozen=True)
class SharedParts:
    """Parts that the goals of all arms have in common.

    Attributes:
        parameters: of planning.
        context: all that goals are planned with.
        queue: of goals.
        states: the named states.
        confirmation: decides if goals are to be confirmed.
        in_progress: motions of all goals.
        time_limits: of motions.
    """

    parameters: MoveItParameters
    context: PlanningContext
    queue: GoalQueue[Motion]
    states: NamedStates
    confirmation: Confirmation
    in_progress: MotionsInProgress
    time_limits: TimeLimits


class ArmGoals:
    """Goals of one arm.

    Args:
        graph: the namespace of the arm.
        name: of the arm.
        own: its own description, part of that of all arms.
        arm: the arm.
        gripper_torque_limit: share of full motor duty that its gripper may use.
        shared: parts that the goals of all arms have in common.

    Attributes:
        actions: names of its actions.
        follower: the arm as one that can follow another.
    """

    def __init__(
        self,
        graph: Graph,
        name: str,
        own: RobotModel,
        arm: ArmInterface,
        gripper_torque_limit: float,
        shared: SharedParts,
    ) -> None:
        context, queue = shared.context, shared.queue
        self._joints = frozenset(joint.name for joint in own.movable_joints)
        self._queue = queue
        parameters = shared.parameters.model_copy(
            update={"group_name": own.default_group, "end_effector_link": own.tip_link}
        )
        only = OneArm(f"{name}_", self._joints)
        translator = GoalTranslator(
            context.robot, parameters, shared.states, context.frames, context.current, context.problems, only
        )
        node = Node(f"moveit of {name}")
        self._status = GoalStatusTopics(graph, node, context.robot)
        self._topics = GoalTopics(graph, node, queue, translator, shared.confirmation, self._joints)
        self._calls = GoalCalls(graph, queue, translator, shared.confirmation, context)
        self._servo = ServoNode(
            graph,
            context.robot,
            parameters,
            context.scene_state,
            context.frames.resolve,
            arm,
            context.pool,
            lambda: queue.busy_with(self._joints),
            context.current,
        )
        self._gripper = None
        actions = [GOAL_ACTION]
        if own.gripper is not None:
            joints = [own.joints[joint] for joint in own.gripper.joints]
            scalings = parameters.max_velocity_scaling, parameters.max_acceleration_scaling
            self._gripper = Gripper(
                arm, joints, *scalings, shared.time_limits, gripper_torque_limit, shared.in_progress
            )
            GripperActions(graph, self._gripper)
            actions += [GRIPPER_ACTION, FETCH_ACTION, PARALLEL_ACTION]
        setup = servo_setup(context.robot, parameters)
        self.follower = Follower(name, only.prefix, own, arm, setup, self._gripper)
        self._controllers = []
        self._controller_states = []
        for group in own.groups.values():
            # Below the arm's name as those of an arm that is alone.
            plain = group.name.removeprefix(only.prefix)
            controller = JointTrajectoryController(
                graph,
                context.robot,
                group,
                arm,
                context.current,
                queue,
                shared.time_limits,
                industrial=group.name == own.default_group,
                name=plain,
                refuses_faster=parameters.faster_trajectories == "refuse",
            )
            self._controllers.append(controller)
            self._controller_states.append(ControllerStatePublisher(graph, group, plain))
            actions += controller.actions
        self.actions = tuple(map(graph.resolve, actions))
        self._below = graph.resolve("/")

    def open(self) -> None:
        """Take requests."""
        self._status.open()
        self._topics.open()
        self._calls.open()

    def take_state(self, state: ArmState) -> None:
        """Pass the arm's latest state on to its controllers."""
        for controller in self._controllers:
            controller.take_state(state)
        for publisher in self._controller_states:
            publisher.take_state(state)

    def take_progress(self, goal: QueuedGoal[Motion], progress: Progress) -> None:
        """Publish the progress of a goal that moves this arm."""
        if goal.joints & self._joints:
            self._status.publish_progress(goal, progress)

    def take_answer(self, goal: QueuedGoal[Motion], answer: Answer) -> None:
        """Publish the answer to a goal that moves this arm, or was sent to it and refused."""
        if goal.joints & self._joints or goal.source.startswith(self._below):
            self._status.publish_answer(goal, answer, logged=True)

    @property
    def running(self) -> RunningGoal | None:
        """The goal that occupies the arm or its gripper; None when there is none."""
        remaining_s = None if self._gripper is None else self._gripper.remaining_s
        return self._queue.running_with(self._joints) or (
            None if remaining_s is None else RunningGoal("a goal of the gripper", remaining_s)
        )

    def stop(self, reason: str) -> None:
        """End the goals that move this arm, and every motion of it."""
        self._queue.stop(reason, self._joints)

    async def close(self) -> None:
        """Release the arm."""
        await self._servo.close()
