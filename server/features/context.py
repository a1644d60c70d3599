"""Context in which the features of the server are made: its arms, its planning, and the way of goals to the arms."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from planners.interface import Planners
from robot.arm import Arm
from robot.arm_group import AnyArm, ArmGroup
from server.access.authorization import Access
from server.arm.arms import ServedArm
from server.config import Settings
from server.execution.confirmation import Confirmation
from server.execution.executor import GoalExecutors
from server.execution.goal import Answer, Goal, GoalRequest, TimeLimits
from server.execution.monitors import CurrentState
from server.execution.motions import Positions
from server.execution.queue import GoalListener, GoalQueue, RunningGoal
from server.graph.topics import Graph, LocalGraph, LocalNode
from server.lifecycle import Feature
from server.monitoring.monitor import GoalCounters
from server.moveit.actions.gripper import Gripper
from server.moveit.display import DisplayTopics
from server.moveit.goals.goal_topics import GoalOptions, GoalTranslator
from server.moveit.named_states import NamedStates, default_path
from server.moveit.parameters import MoveItParameters, PlannerParameters
from server.moveit.requests.constraints import planning_group
from server.moveit.requests.planning_context import GoalContext, PlanningContext
from server.moveit.scene.frames import Frames
from server.moveit.scene.scene_state import AssumedStates, SceneState
from server.rosapi import RosApi

# Time that the queue waits for the arm to brake; the arm process has its own deadline after that.
QUEUE_CLOSE_TIMEOUT_S = 1.0


class Goals(Feature, GoalListener):
    """Way of goals to the arms, which counts their answers."""

    name = "the goal queue"
    deadline_s = QUEUE_CLOSE_TIMEOUT_S + 0.1

    def __init__(self, arm: AnyArm, planning: PlanningContext, settings: Settings) -> None:
        goals, robot = settings.goals, planning.robot
        self.executors = GoalExecutors(arm, planning)
        self.queue = GoalQueue(self.executors, goals.policy, goals.capacity)
        self.queue.listeners.append(self)
        path = goals.named_states_file or default_path("named_states", robot, os.environ)
        self.named_states = NamedStates(robot, planning.problems.group("").name, path)
        self.counters = GoalCounters()

    async def start(self) -> None:
        """Take goals, which wait until arm and planners have started."""
        self.queue.start()

    async def stop(self) -> None:
        await self.queue.close(QUEUE_CLOSE_TIMEOUT_S)

    def on_answer(self, goal: Goal, answer: Answer) -> None:
        self.counters.count(goal.request.source, answer)


@dataclass(frozen=True, eq=False, kw_only=True)
class ArmContext(GoalContext):
    """Context of the features of one arm, or of all arms together."""

    served: ServedArm
    goals: Goals
    node: LocalNode

    @property
    def name(self) -> str:
        """Name of one of several arms; else empty."""
        return self.served.name

    @cached_property
    def translator(self) -> GoalTranslator:
        return GoalTranslator(
            self.planning, self.parameters, self.goals.named_states, self.served.prefix, self.only_joints
        )

    @cached_property
    def gripper(self) -> Gripper | None:
        if self.robot.gripper is None:
            return None
        torque_limit = self.served.settings.guards.gripper_torque_limit
        return Gripper(self, self.robot.gripper.joints, torque_limit, self.goals.executors.in_progress)

    def running(self) -> RunningGoal | None:
        """Return the goal that occupies the arm or its gripper; None when there is none."""
        remaining_s = None if self.gripper is None else self.gripper.remaining_s
        return self.queue.running(self.joints) or (
            None if remaining_s is None else RunningGoal("a goal of the gripper", remaining_s)
        )

    def go_to(self, positions_rad: Positions, scaling: float) -> Goal:
        """Queue a goal for joints of the arm, at a share of the velocity and acceleration limits."""
        message = {"name": list(positions_rad), "position": list(positions_rad.values())}
        slow = {"max_velocity_scaling": scaling, "max_acceleration_scaling": scaling}
        motion = self.translator.joints(message, GoalOptions(parameters=self.parameters.changed(slow)))
        return self.queue.submit(GoalRequest("the server", motion, message))


@dataclass(frozen=True, eq=False)
class ServerContext:
    """Context of all features; the arms are the whole, which is the only arm or all together, then each of several."""

    settings: Settings
    graph: Graph
    arms: tuple[ArmContext, ...]
    planning: PlanningContext
    goals: Goals
    access: Access
    rosapi: RosApi

    @property
    def whole(self) -> ArmContext:
        return self.arms[0]

    @property
    def single_arms(self) -> list[tuple[ArmContext, Arm]]:
        """Each arm by itself, with the handle on its process."""
        return [(each, each.arm) for each in self.arms if not isinstance(each.arm, ArmGroup)]


def context_of(
    settings: Settings, graph: Graph, arms: tuple[ServedArm, Sequence[ServedArm]], pool: Planners
) -> ServerContext:
    whole_arm, single_arms = arms
    moveit, robot = settings.moveit, whole_arm.robot
    scene, display = SceneState(robot), DisplayTopics(graph, robot)
    planning = PlanningContext(
        robot=robot,
        pool=pool,
        frames=Frames(scene),
        scene_state=scene,
        current=CurrentState(whole_arm.arm),
        assumed=AssumedStates(robot),
        parameters=PlannerParameters(moveit.model_copy(update={"group_name": planning_group(robot, "", moveit).name})),
        display=display,
        show=display.performed,
        clock=graph.clock,
        time_limits=TimeLimits(
            moveit.allowed_execution_duration_scaling,
            moveit.allowed_goal_duration_margin,
            settings.goals.max_paused_s,
            settings.goals.max_trajectory_duration_s,
        ),
        confirmation=Confirmation(graph, enabled=settings.goals.confirm, timeout_s=settings.goals.confirm_timeout_s),
    )
    goals = Goals(whole_arm.arm, planning, settings)

    def arm_context(served: ServedArm, parameters: MoveItParameters, node_name: str) -> ArmContext:
        local = LocalGraph(graph, served.name)
        return ArmContext(
            graph=local,
            arm=served.arm,
            robot=served.robot,
            parameters=parameters,
            planning=planning,
            queue=goals.queue,
            served=served,
            goals=goals,
            node=local.node(node_name),
        )

    whole = arm_context(whole_arm, moveit, "moveit")
    several = []
    for each in single_arms:
        if each is not whole_arm:
            own = {"group_name": each.robot.default_group, "end_effector_link": each.robot.tip_link}
            several.append(arm_context(each, moveit.model_copy(update=own), f"moveit of {each.name}"))
    access = Access(settings.access, busy=whole.running, arms={each.name: each.running for each in several})
    return ServerContext(settings, graph, (whole, *several), planning, goals, access, RosApi(graph))
