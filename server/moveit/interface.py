"""Interface of MoveIt: its parts, and the order in which they start and stop."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable

from planners.interface import Planners
from robot.arm_interface import ArmInterface
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.messages import ArmState
from server.config import Settings
from server.execution.executor import GoalExecutor, GoalExecutors
from server.execution.failures import FailedGoals
from server.execution.monitors import CurrentState
from server.execution.motions import Motion, Positions
from server.execution.motions_in_progress import MotionsInProgress
from server.execution.queue import Answer, GoalQueue, Progress, QueuedGoal, RunningGoal
from server.execution.time_limits import TimeLimits
from server.graph.node import Node
from server.graph.topics import Graph
from server.monitoring.goal_counters import GoalCounters
from server.moveit.actions.move_group import MotionActions
from server.moveit.arm_goals import ArmGoals, SharedParts
from server.moveit.description import RobotDescription
from server.moveit.display import DisplayTopics, TransformsTopics
from server.moveit.goal_calls import GoalCalls
from server.moveit.goal_history import GoalHistory
from server.moveit.goal_messages import GoalOptions, GoalTranslator
from server.moveit.goal_topics import Confirmation, GoalChecks, GoalReports, GoalStatusTopics, GoalTopics
from server.moveit.gripper import FETCH_ACTION, GRIPPER_ACTION, PARALLEL_ACTION, Gripper, GripperActions
from server.moveit.named_states import NamedStates, NamedStatesFile, NamedStatesServices, default_path
from server.moveit.parameters import PlannerParameters
from server.moveit.requests.context import planning_group
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.scene.frames import Frames
from server.moveit.scene.interface import SceneInterface
from server.moveit.scene.named_scenes import NamedScenes, offer_named_scenes
from server.moveit.scene.saved_scene import SavedScene, SceneFile
from server.moveit.scene.scene_state import AssumedStates, SceneState
from server.moveit.services.move_group_services import offer_services
from server.moveit.servo.servo_node import ServoNode, servo_setup
from server.teaching.motion_files import MotionFiles
from server.teaching.replay import ReplayAction
from server.teaching.services import Teaching
from server.teleop.session import Follower
from server.teleop.teleoperation import Teleoperation

# The queue waits so long for the arm to brake; the arm process has its own deadline after that.
QUEUE_CLOSE_TIMEOUT_S = 1.0


class MoveItInterface:
    """All topics, services and actions of MoveIt's clients, and those of clients that know only topics.

    Args:
        graph: where they are.
        robot: the arm's description.
        settings: of the server.
        keep_parameter: keeps a parameter for rosapi, its value as JSON text.
        arm: the arm; started before goals are executed.
        pool: the planners; likewise.

    Attributes:
        goal_counters: counters of answered goals.
        queue: of goals.
        scene: the planning scene.
        teaching: recording of motions.
        teleoperation: following of a leader.
    """

    def __init__(
        self,
        graph: Graph,
        robot: RobotModel,
        settings: Settings,
        keep_parameter: Callable[[str, str], None],
        arm: ArmInterface,
        pool: Planners,
    ) -> None:
        moveit, goals = settings.moveit, settings.goals
        self._graph = graph
        self._current = CurrentState(arm, robot)
        self.scene = SceneState(robot)
        frames = Frames(robot, self.scene)
        assumed = AssumedStates(robot)
        self._scene_interface = SceneInterface(graph, robot, self.scene, assumed, self._current, moveit)
        self._saved_scene: SavedScene | None = None
        if settings.scene.keep:
            file = SceneFile(settings.scene.file or default_path("planning_scene", robot, os.environ))
            self._saved_scene = SavedScene(file, self.scene, robot, graph.message_types)
        # Beside the file of the present scene, in a folder of their own.
        folder = default_path("scenes", robot, os.environ).with_suffix("")
        offer_named_scenes(graph, NamedScenes(folder, self.scene, robot, graph.message_types), self._current)
        self._description = RobotDescription(graph, robot, keep_parameter)
        self._display = DisplayTopics(graph, robot)
        self._transforms = TransformsTopics(graph, robot, settings.arm.tf_rate_hz)

        # The way of a goal: from a topic or an action to the queue, and from there to the arm.
        time_limits = TimeLimits(
            moveit.allowed_execution_duration_scaling,
            moveit.allowed_goal_duration_margin,
            goals.max_paused_s,
            goals.max_trajectory_duration_s,
        )
        directory, max_files = settings.planning.save_failed_goals, settings.planning.keep_failed_goals
        failed_goals = None if directory is None else FailedGoals(directory, robot, time.time, max_files)
        self._confirmation = Confirmation(graph, enabled=goals.confirm, timeout_s=goals.confirm_timeout_s)

        def make_executor(part: ArmInterface, in_progress: MotionsInProgress) -> GoalExecutor:
            return GoalExecutor(
                part,
                robot,
                pool,
                self.scene,
                failed_goals,
                self._display.performed,
                self._confirmation.wait,
                time_limits,
                in_progress,
                self._current,
            )

        self._executors = GoalExecutors(arm, make_executor)
        node = Node("moveit")
        self.goal_counters = GoalCounters()
        self._goal_status = GoalStatusTopics(graph, node, robot)
        self._goal_history = GoalHistory(graph, robot, lambda: self.scene.scene, time.time)
        self.queue: GoalQueue[Motion] = GoalQueue(
            self._executors, goals.policy, goals.capacity, self._on_progress, self._on_answer
        )

        group = planning_group(robot, "", moveit)
        self._context = PlanningContext(
            robot=robot,
            pool=pool,
            forward=ForwardPlacements(robot),
            frames=frames,
            scene_state=self.scene,
            current=self._current,
            assumed=assumed,
            parameters=PlannerParameters(moveit.model_copy(update={"group_name": group.name})),
            display=self._display,
        )

        # Goals of clients that know only topics.
        states_file = NamedStatesFile(goals.named_states_file or default_path("named_states", robot, os.environ))
        states = NamedStates(robot, group.name, states_file.load(), states_file.change)
        self._named_states = NamedStatesServices(graph, robot, states, self._current)
        translator = GoalTranslator(robot, moveit, states, frames, self._current, self._context.problems)
        self._translator = translator
        self._shared = SharedParts(
            moveit, self._context, self.queue, states, self._confirmation, self._executors.in_progress, time_limits
        )
        self._arms: list[ArmGoals] = []
        self._goal_topics = GoalTopics(graph, node, self.queue, translator, self._confirmation)
        self._goal_calls = GoalCalls(graph, self.queue, translator, self._confirmation, self._context)
        reports = GoalReports(robot, moveit)
        self._goal_checks = GoalChecks(graph, reports, translator, self._current, pool, self.scene)

        # Goals and commands of MoveIt's clients.
        steered = arm.part(group.joints)
        steered_joints = frozenset(joint.name for joint in robot.movable_joints if arm.part((joint.name,)) is steered)
        self._servo = ServoNode(
            graph,
            robot,
            moveit,
            self.scene,
            frames.resolve,
            steered,
            pool,
            lambda: self.queue.busy_with(steered_joints),
            self._current,
        )
        self._gripper = None
        if robot.gripper is not None:
            joints = [robot.joints[name] for name in robot.gripper.joints]
            scalings = moveit.max_velocity_scaling, moveit.max_acceleration_scaling
            torque_limit = settings.arm.guards.gripper_torque_limit
            in_progress = self._executors.in_progress
            self._gripper = Gripper(
                arm.part(robot.gripper.joints), joints, *scalings, time_limits, torque_limit, in_progress
            )
            GripperActions(graph, self._gripper)
        self._actions = MotionActions(graph, self._context, arm, self.queue, time_limits)

        # Motions that people teach, in a folder beside the named states.
        motions = MotionFiles(default_path("motions", robot, os.environ).with_suffix(""), robot)
        self.teaching = Teaching(graph, robot, motions, pool, self.scene, self._current)
        self._replay = ReplayAction(graph, robot, motions, self.queue, moveit)

        # One arm follows another, of this server or elsewhere.
        self.teleoperation = Teleoperation(graph, self._context, self.queue, self.go_to)
        if not settings.arms:
            self.teleoperation.add_follower(Follower("arm", "", robot, arm, servo_setup(robot, moveit), self._gripper))

    def add_arm(
        self,
        graph: Graph,
        name: str,
        own: RobotModel,
        arm: ArmInterface,
        gripper_torque_limit: float,
        *,
        leads: bool = False,
    ) -> ArmGoals:
        """Add the goals of one of several arms, before the start.

        Args:
            graph: as of :class:`ArmGoals`, and so the arguments up to its torque limit.
            name: likewise.
            own: likewise.
            arm: likewise.
            gripper_torque_limit: likewise.
            leads: True for an arm that others follow.
        """
        goals = ArmGoals(graph, name, own, arm, gripper_torque_limit, self._shared)
        self._arms.append(goals)
        if leads:
            self.teleoperation.add_leader(name)
        else:
            self.teleoperation.add_follower(goals.follower)
        return goals

    async def restore_scene(self) -> None:
        """Restore the planning scene of the run before, and keep its changes from now on."""
        if self._saved_scene is not None:
            await self._saved_scene.start()

    async def keep_scene(self) -> None:
        """Write the last changes of the planning scene."""
        if self._saved_scene is not None:
            await self._saved_scene.close()

    def start(self) -> None:
        """Take requests; goals wait until arm and planners have started."""
        self.queue.start()
        self._description.open()
        self._transforms.open(time.time())
        self._confirmation.open()
        self._goal_status.open()
        self._goal_history.open()
        self._goal_topics.open()
        self._goal_calls.open()
        self._named_states.open()
        self._goal_checks.open()
        self._display.open()
        offer_services(self._graph, self._context)
        self.teaching.open()
        self._replay.open()
        self.teleoperation.open()
        gripper_actions = () if self._gripper is None else (GRIPPER_ACTION, FETCH_ACTION, PARALLEL_ACTION)
        for arm in self._arms:
            arm.open()
        self._actions.open((*gripper_actions, *(action for arm in self._arms for action in arm.actions)))

    def take_state(self, state: ArmState) -> None:
        """Pass the arm's latest state on to the parts that publish or record it."""
        self._transforms.take_state(state)
        self._executors.take_state(state)
        self._actions.take_state(state)
        self.teaching.take_state(state)

    @property
    def running(self) -> RunningGoal | None:
        """The goal that occupies the arm or its gripper; None when there is none."""
        remaining_s = None if self._gripper is None else self._gripper.remaining_s
        return self.queue.running or (
            None if remaining_s is None else RunningGoal("a goal of the gripper", remaining_s)
        )

    def go_to(self, positions_rad: Positions, scaling: float) -> tuple[str, asyncio.Future[Answer]]:
        """Queue a goal for joints of the arm.

        Args:
            positions_rad: joint -> position [rad].
            scaling: share of the velocity and acceleration limits.

        Returns:
            Its number, and its answer to come.

        Raises:
            RefusedError: there is no such joint.
        """
        message = {"name": list(positions_rad), "position": list(positions_rad.values())}
        motion = self._translator.joints(message, GoalOptions(None, scaling, scaling))
        answered: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
        return self.queue.submit("the server", motion, on_answer=answered.set_result, message=message), answered

    def stop(self, reason: str) -> None:
        """End the active goal and all that wait, and stop every motion."""
        self.queue.stop(reason)

    async def close(self) -> None:
        """Answer every goal, and bring the arm to rest."""
        self._scene_interface.close()
        await self.teleoperation.close()
        await asyncio.gather(self._servo.close(), *(arm.close() for arm in self._arms))
        await self.queue.close(QUEUE_CLOSE_TIMEOUT_S)
        await self.teaching.close()

    def _on_progress(self, goal: QueuedGoal[Motion], progress: Progress) -> None:
        self._goal_history.take_progress(goal, progress)
        self._goal_status.publish_progress(goal, progress)
        for arm in self._arms:
            arm.take_progress(goal, progress)

    def _on_answer(self, goal: QueuedGoal[Motion], answer: Answer) -> None:
        self.goal_counters.count(goal.source, answer)
        self._display.contacts_of(answer.details)
        status = self._goal_status.publish_answer(goal, answer)
        self._goal_history.take_answer(goal, answer, status)
        for arm in self._arms:
            arm.take_answer(goal, answer)
