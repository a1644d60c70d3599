"""The server's parts in one event loop, without sockets: a client on the graph asks for motions of every kind.

The parts are the real ones, in stepped time; the arm is one that a test chooses.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextvars import Context
from typing import Any, cast

import numpy as np
import pytest

from planners.interface import Planners
from planners.problem import Answer, Request
from planners.scene import EMPTY_SCENE, Scene
from protocol.registry import Registry
from robot.arm import Arm
from server.arm.commissioning import Commissioning, Procedure
from server.arm.services import ArmPace, ArmServices
from server.arm.verifying import VerificationProcedure
from server.config import ArmSettings, Settings
from server.execution.parking import Parking
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.interface import MoveItInterface
from server.teaching.taught_motion import TaughtMotion
from tests.helpers.moveit import ROBOT, DirectPool

# The planners' time for each question [s].
PLANNING_S = 0.02

DEFAULTS = Settings()

PAN = {"name": ["shoulder_pan"], "position": [0.4]}
ARM_JOINTS = ROBOT.groups["arm"].joints
WAVE = TaughtMotion(ARM_JOINTS, np.arange(6) * 0.2, np.linspace(0.1, 0.3, 6)[:, np.newaxis] * np.ones(len(ARM_JOINTS)))
TRAJECTORY = {
    "joint_names": list(ARM_JOINTS),
    "points": [{"positions": [0.1, 0.0, 0.0, 0.0, 0.0], "time_from_start": {"sec": 2, "nanosec": 0}}],
}


class TimedPool(DirectPool):
    """Planner whose answers take time."""

    async def ask(self, request: Request, scene: Scene = EMPTY_SCENE) -> Answer:
        await asyncio.sleep(PLANNING_S)
        return await super().ask(request, scene)


class ServerStage:
    """Server without sockets, and a client.

    Args:
        arm: the arm.
        settings: of the server.
    """

    def __init__(self, arm: Arm, settings: Settings = DEFAULTS) -> None:
        self.graph = Graph(Registry.load())
        pool = cast("Planners", TimedPool())
        self._arm = arm
        self.moveit = MoveItInterface(self.graph, ROBOT, settings, lambda _name, _value: None, arm, pool)
        parking = Parking(arm, ROBOT, ArmSettings(), settings.moveit, pool, self.moveit.scene, self.moveit.queue)
        ArmServices(self.graph, arm, self.moveit.stop, parking.park)
        ArmPace(self.graph, arm)
        self._commissioning = Commissioning(self.graph, self._verification)
        self.moveit.start()
        # Their time is that of the event loop.
        clock = asyncio.get_running_loop().time
        self.moveit.teleoperation._clock = self.moveit._servo._session._clock = clock
        self.client = Node("client", remote=True)
        self.answers: list[Any] = []

    def _verification(self, _procedure: str, _name: str) -> Procedure:
        moveit = self.moveit
        return VerificationProcedure(self._arm, ROBOT, frozenset(), moveit.go_to, moveit.queue.cancel)

    def publish(self, topic: str, type_name: str, message: dict[str, Any]) -> None:
        if self.client not in self.graph.publishers(topic):
            self.graph.advertise(self.client, topic, type_name)
        self.graph.publish(self.client, topic, message)

    def call(self, service: str, **request: Any) -> None:
        self.graph.services.call(self.client, service, request, self.answers.append)

    def send(self, action: str, type_name: str, **goal: Any) -> None:
        self.graph.actions.send_goal(self.client, action, type_name, goal, self.answers.append)

    async def save_wave(self) -> None:
        """Save the motion that a replay plays."""
        await self.moveit.teaching._motions.save("wave", WAVE)

    async def close(self) -> None:
        """End everything."""
        await self._commissioning.close()
        await self.moveit.close()


def verify(stage: ServerStage) -> None:
    stage.call("/arm/commissioning/begin", procedure="verify", name="")
    loop = asyncio.get_running_loop()
    loop.call_later(0.05, lambda: stage.call("/arm/commissioning/answer", step="torque", answer="move"))


def follow(stage: ServerStage) -> None:
    """Follow a topic whose first sample comes later."""
    stage.call("/teleop/start", leader="/glove")

    async def lead() -> None:
        for number in range(100):
            await asyncio.sleep(0.02)
            stamp = {"sec": 5, "nanosec": 20_000_000 * (number % 50)} if number < 50 else {"sec": 6, "nanosec": 0}
            sample = {"header": {"stamp": stamp}, "name": ["shoulder_pan"], "position": [0.1 + 0.002 * number]}
            stage.publish("/glove", "sensor_msgs/JointState", sample)

    Context().run(lambda: stage.answers.append(asyncio.ensure_future(lead())))


def jog(stage: ServerStage) -> None:
    stage.publish(
        "/servo_node/delta_joint_cmds",
        "control_msgs/JointJog",
        {"joint_names": ["shoulder_pan"], "velocities": [0.8], "displacements": [], "duration": 0.0},
    )


GROUP_GOAL = {
    "request": {
        "group_name": "arm",
        "goal_constraints": [{"joint_constraints": [{"joint_name": "shoulder_pan", "position": 0.4}]}],
    }
}
REQUESTS: dict[str, Callable[[ServerStage], None]] = {
    "a named goal": lambda stage: stage.publish("/moveit_goal_named", "std_msgs/String", {"data": "ready"}),
    "joints": lambda stage: stage.publish("/moveit_goal_joints", "sensor_msgs/JointState", PAN),
    "a called goal": lambda stage: stage.call("/moveit_goal", joints=PAN),
    "MoveGroup": lambda stage: stage.send("/move_action", "moveit_msgs/action/MoveGroup", **GROUP_GOAL),
    "a trajectory": lambda stage: stage.send(
        "/arm_controller/follow_joint_trajectory", "control_msgs/action/FollowJointTrajectory", trajectory=TRAJECTORY
    ),
    "the controller's topic": lambda stage: stage.publish(
        "/arm_controller/joint_trajectory", "trajectory_msgs/JointTrajectory", TRAJECTORY
    ),
    "the gripper": lambda stage: stage.send(
        "/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand", command={"position": 0.8}
    ),
    "a replay": lambda stage: stage.send("/replay_motion", "armbridge_msgs/action/ReplayMotion", name="wave"),
    "parking": lambda stage: stage.call("/arm/park"),
    "enabling": lambda stage: stage.call("/arm/enable"),
    "a verification": verify,
    "a following": follow,
    "a jog": jog,
}


def inline_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the work of threads done by the event loop, a step later: stepped time waits for no thread."""

    async def run(work: Callable[..., Any], *arguments: Any) -> Any:
        await asyncio.sleep(0.01)
        return work(*arguments)

    monkeypatch.setattr(asyncio, "to_thread", run)
