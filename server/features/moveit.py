"""Features of MoveIt's clients, and of clients that know only topics: scene, planning, goals, gripper and servo."""

import asyncio
import logging
import os
import time
from pathlib import Path

from planners.servo.question import ACCELERATION_SHARE, APPROACH_PER_S
from robot.description.model import RobotModel
from robot.messages import ArmState
from server.actionlib import bridge_actions
from server.config import Settings
from server.features.context import ArmContext, ServerContext
from server.lifecycle import Feature
from server.moveit.actions.goal_calls import GoalCalls
from server.moveit.actions.gripper import offer_gripper
from server.moveit.actions.joint_trajectory_controller import JointTrajectoryController
from server.moveit.actions.move_group import offer_execute_trajectory, offer_planning_actions
from server.moveit.goals.goal_checks import offer_goal_checks
from server.moveit.goals.goal_history import GoalHistory
from server.moveit.goals.goal_topics import GoalStatusTopics, GoalTopics
from server.moveit.named_states import NamedStatesServices, default_path
from server.moveit.requests.constraints import planning_group
from server.moveit.scene.interface import SceneInterface
from server.moveit.scene.saved_scene import NamedScenes, SavedScene, offer_named_scenes
from server.moveit.services.description import TransformRepublisher, TransformsTopics, offer_description, publish_groups
from server.moveit.services.move_group_services import offer_services
from server.moveit.servo.servo_node import ServoNode

log = logging.getLogger("armbridge.servo")

# A joint that brakes from its full speed within this time comes to rest before the limits that steering approaches.
BRAKES_WITHIN_S = 2.0 * ACCELERATION_SHARE / APPROACH_PER_S


def kept_scene_path(settings: Settings, robot: RobotModel) -> Path:
    """Return the default file of the kept scene: an arm, its simulation, and each set of arms have one of their own."""
    real = any(arm.serial is not None for arm in (settings.arm, *settings.arms.values()))
    names = ["planning_scene", *sorted(settings.arms), *(["real"] if real else [])]
    return default_path("_".join(names), robot, os.environ)


class PlanningScene(Feature):
    """The planning scene: its topics and services, named scenes, and the file from which the next start restores it."""

    name = "the planning scene"
    deadline_s = 0.4

    def __init__(self, context: ServerContext) -> None:
        planning, graph, settings = context.planning, context.graph, context.settings
        scene, robot = planning.scene_state, planning.robot
        self._interface = SceneInterface(graph, scene, planning.assumed, planning.current, settings.moveit)
        self._saved: SavedScene | None = None
        # A world of the physics begins as its file has it.
        if settings.scene.keep and settings.simulation.world is None:
            path = settings.scene.file or kept_scene_path(settings, robot)
            self._saved = SavedScene(path, scene, graph.message_types)
        # Beside the file of the present scene, in a folder of their own.
        folder = default_path("scenes", robot, os.environ).with_suffix("")
        offer_named_scenes(graph, NamedScenes(folder, scene, graph.message_types), planning.current)

    async def start(self) -> None:
        """Restore the scene of the run before, and keep its changes from now on."""
        if self._saved is not None:
            await self._saved.start()

    async def stop(self) -> None:
        self._interface.close()
        if self._saved is not None:
            await self._saved.close()


class MoveGroup(Feature):
    """Services and actions of move_group, with description, transforms, named states and the records of goals."""

    name = "move_group"

    def __init__(self, context: ServerContext) -> None:
        graph, planning, goals = context.graph, context.planning, context.goals
        robot = planning.robot
        offer_description(graph, robot, context.rosapi.parameters.keep)
        several = {arm.name: arm.robot for arm in context.arms if arm.name}
        publish_groups(graph, robot, several or {"": robot}, context.whole.parameters)
        self._transforms = TransformsTopics(graph, robot)
        self._republisher = TransformRepublisher(graph, planning.frames)
        NamedStatesServices(graph, robot, goals.named_states, planning.current)
        offer_goal_checks(graph, context.whole.translator)
        offer_planning_actions(graph, planning, goals.queue)
        offer_execute_trajectory(graph, planning, goals.queue)
        offer_services(graph, planning)
        goals.queue.listeners.append(GoalHistory(graph, planning, time.time))

    def on_state(self, arm: str, state: ArmState) -> None:
        if not arm:
            self._transforms.take_state(state)
            self._republisher.take_state(state)


class ArmGoals(Feature):
    """Goals of each arm by topics, services and actions; every group with a driven joint has a controller."""

    name = "goals of the arms"

    def __init__(self, context: ServerContext) -> None:
        self._controllers: dict[str, list[JointTrajectoryController]] = {}
        for arm in context.arms:
            self._offer(arm)
        self._graph = context.graph

    async def start(self) -> None:
        bridge_actions(self._graph)

    def on_state(self, arm: str, state: ArmState) -> None:
        for controller in self._controllers[arm]:
            controller.take_state(state)

    def _offer(self, arm: ArmContext) -> None:
        """Offer goals of an arm; goals of several arms are published by the names of each arm that they move too."""
        graph, queue, robot = arm.graph, arm.queue, arm.planning.robot
        queue.listeners.append(GoalStatusTopics(arm.node, robot, arm.only_joints))
        GoalTopics(arm.node, queue, arm.translator, arm.only_joints)
        GoalCalls(graph, queue, arm.translator)
        default = planning_group(robot, "", arm.parameters).name
        controllers = self._controllers[arm.name] = []
        for group in arm.robot.groups.values():
            name, industrial = group.name.removeprefix(arm.served.prefix), group.name == default
            controllers.append(JointTrajectoryController(arm, group, name, industrial=industrial))
        if arm.gripper is not None:
            offer_gripper(graph, arm.gripper)


class Servo(Feature):
    """MoveIt Servo for each arm."""

    name = "servo"
    deadline_s = 0.5

    def __init__(self, context: ServerContext) -> None:
        self.nodes = {arm.name: ServoNode(arm) for arm in context.arms}
        for joint, brakes_s in slow_to_brake(context.planning.robot).items():
            log.info(
                "joint %s needs %.1f s to brake from its full speed, so steering approaches limits and obstacles more "
                "slowly with it (max_velocity and max_acceleration in robot.toml)",
                joint,
                brakes_s,
            )

    async def stop(self) -> None:
        await asyncio.gather(*(node.close() for node in self.nodes.values()))


def slow_to_brake(robot: RobotModel) -> dict[str, float]:
    """Return the joints that brake more slowly than steering expects, with their times to brake [s]."""
    brakes_s = {joint.name: joint.max_velocity / joint.max_acceleration for joint in robot.movable_joints}
    return {name: time_s for name, time_s in brakes_s.items() if time_s > BRAKES_WITHIN_S}
