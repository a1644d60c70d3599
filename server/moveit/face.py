"""MoveIt's face as a whole: which parts it has, and in which order they begin and end."""

from __future__ import annotations

import time
from collections.abc import Callable

from planners.pool import PlannerPool
from robot.arm import Arm
from robot.calibration import GRIPPER_JOINT
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import Joint, RobotModel
from robot.messages import ArmState
from server.config import Settings
from server.goal_queue import Answer, GoalQueue, QueuedGoal
from server.graph.topics import Graph
from server.monitoring.metrics import GoalCounters
from server.moveit.actions.move_group import MotionActions
from server.moveit.current_state import CurrentState
from server.moveit.description import RobotDescription
from server.moveit.display import DisplayTopics
from server.moveit.execution import GoalExecutor
from server.moveit.failed_goals import FailedGoals
from server.moveit.gripper import Gripper
from server.moveit.gripper_actions import GRIPPER_ACTION, PARALLEL_ACTION, GripperActions
from server.moveit.motions import Motion
from server.moveit.patience import Allowance
from server.moveit.planner_parameters import PlannerParameters
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.scene.frames import Frames
from server.moveit.scene.interface import SceneInterface
from server.moveit.scene.scene_state import AssumedStates, SceneState
from server.moveit.services.move_group_services import offer_services
from server.moveit.servo.servo_node import ServoNode
from server.moveit.simple_layer import SimpleLayer
from server.moveit.transforms_topics import TransformsTopics

# The queue waits this long for the arm to brake; the arm process has its own deadline after that.
QUEUE_CLOSE_TIMEOUT_S = 1.0


class MoveItFace:
    """Everything that MoveIt's clients talk to.

    Args:
        graph: where they talk.
        robot: the arm.
        settings: everything that can be chosen.
        keep_parameter: keeps a parameter for rosapi, its value as JSON text.

    Attributes:
        goal_counters: counters of answered goals.
        queue: goals on their way; None until it is opened.
    """

    def __init__(
        self, graph: Graph, robot: RobotModel, settings: Settings, keep_parameter: Callable[[str, str], None]
    ) -> None:
        self._graph = graph
        self._robot = robot
        self._settings = settings
        self._scene = SceneState(robot)
        self._frames = Frames(robot, self._scene)
        self._assumed = AssumedStates(robot)
        self._scene_interface = SceneInterface(graph, robot, self._scene, self._assumed, settings.moveit)
        self._parameters = PlannerParameters(settings.moveit)
        self._display = DisplayTopics(graph, robot)
        self._description = RobotDescription(graph, robot, keep_parameter)
        self._transforms = TransformsTopics(graph, robot, settings.arm.tf_rate_hz)
        self._simple_layer = SimpleLayer(graph, robot, settings)
        gripper = robot.joints.get(GRIPPER_JOINT)
        # Another arm's gripper is not known by its description.
        self._gripper_joint = gripper if gripper is not None and gripper.movable else None
        directory, keep = settings.planning.save_failed_goals, settings.planning.keep_failed_goals
        self._failed_goals = None if directory is None else FailedGoals(directory, robot, time.time, keep)
        self._servo = ServoNode(graph, robot, settings.moveit, self._scene, self._frames.resolve)
        self.goal_counters = GoalCounters()
        self.queue: GoalQueue[Motion] | None = None
        self._executor: GoalExecutor | None = None
        self._actions: MotionActions | None = None

    def open(self, arm: Arm, pool: PlannerPool) -> None:
        """Begin to take requests, for a started arm and started planners."""
        simple_layer, goals = self._simple_layer, self._settings.goals
        confirm, show = simple_layer.confirmation.ask, self._display.performed
        self._executor = GoalExecutor(
            arm, self._robot, pool, self._scene, self._failed_goals, show, confirm, self._allowance()
        )
        self.queue = GoalQueue(self._executor, goals.policy, goals.capacity, simple_layer.on_progress, self._on_answer)
        self.queue.start()
        self._description.open()
        self._transforms.open(time.time())
        self._scene_interface.open(CurrentState(arm, self._robot))
        simple_layer.open(self.queue, pool, CurrentState(arm, self._robot), self._frames.resolve, self._scene)
        gripper_actions = () if self._gripper_joint is None else self._open_gripper(arm, self._gripper_joint)
        self._display.open()
        context = self._planning_context(arm, pool)
        offer_services(self._graph, context)
        self._actions = MotionActions(self._graph, context, arm, self.queue)
        self._actions.open(gripper_actions)
        queue = self.queue
        self._servo.open(arm, pool, lambda: queue.busy)

    def _on_answer(self, goal: QueuedGoal[Motion], answer: Answer) -> None:
        self.goal_counters.count(goal.source, answer)
        self._display.contacts_of(answer.details)
        self._simple_layer.on_answer(goal, answer)

    def _planning_context(self, arm: Arm, pool: PlannerPool) -> PlanningContext:
        """What the services that plan and compute work with."""
        return PlanningContext(
            robot=self._robot,
            pool=pool,
            forward=ForwardPlacements(self._robot),
            frames=self._frames,
            scene_state=self._scene,
            current=CurrentState(arm, self._robot),
            assumed=self._assumed,
            parameters=self._parameters,
            display=self._display,
        )

    def take_state(self, state: ArmState) -> None:
        """Pass the arm's latest state on to the parts that tell of it."""
        self._transforms.take_state(state)
        if self._executor is not None and self._actions is not None:
            self._executor.recorder.take_state(state)
            self._actions.take_state(state)

    @property
    def busy(self) -> str:
        """Which goal is worked on, in words; empty when there is none."""
        return "" if self.queue is None else self.queue.busy

    def stop(self, reason: str) -> None:
        """End the goal in hand and all that wait, and stop every motion."""
        if self.queue is None:
            raise AssertionError("stopped before it was opened")
        self.queue.stop(reason)

    async def close(self) -> None:
        """Answer every goal, and bring the arm to rest."""
        self._scene_interface.close()
        await self._servo.close()
        if self.queue is not None:
            await self.queue.close(QUEUE_CLOSE_TIMEOUT_S)

    def _open_gripper(self, arm: Arm, joint: Joint) -> tuple[str, ...]:
        """Offer the gripper's actions; returns their names."""
        GripperActions(self._graph, joint).open(self._gripper(arm, joint))
        return GRIPPER_ACTION, PARALLEL_ACTION

    def _gripper(self, arm: Arm, joint: Joint) -> Gripper:
        moveit = self._settings.moveit
        torque_limit = self._settings.arm.guards.gripper_torque_limit
        return Gripper(
            arm, joint, moveit.max_velocity_scaling, moveit.max_acceleration_scaling, self._allowance(), torque_limit
        )

    def _allowance(self) -> Allowance:
        moveit = self._settings.moveit
        scaling, margin_s = moveit.allowed_execution_duration_scaling, moveit.allowed_goal_duration_margin
        return Allowance(scaling, margin_s, self._settings.goals.max_paused_s)
