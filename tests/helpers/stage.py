"""The server's parts in one event loop, without sockets: a client on the graph asks for motions of every kind.

The parts are the real ones, in stepped time; the arm is one that a test chooses.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextvars import Context
from dataclasses import replace
from typing import Any, Self, cast

import numpy as np
import pytest

from planners.interface import Planners
from planners.problem import Answer, Request
from planners.scene import EMPTY_SCENE, Scene
from robot.arm import Arm, ArmProcess
from robot.description.servo_table import HardwareTable
from robot.hardware.config import IdealConfig
from robot.messages import ArmState, Stop
from robot.stop_epochs import STOP_EPOCHS
from robot.trajectory import ACCELERATION_TOLERANCE, PERIOD_S, VELOCITY_TOLERANCE, Vector
from server.arm.arms import ServedArm
from server.arm.setup import Description
from server.arrival import arrived_in
from server.config import Settings
from server.features.arms import ArmControl, CommissioningOfArms, PolicyChunks, teaching_of, teleoperation_of
from server.features.context import context_of
from server.features.moveit import ArmGoals, MoveGroup, Servo
from server.features.parking import Parkings
from server.graph.permissions import Node
from server.graph.topics import Graph
from server.teaching.taught_motion import TaughtMotion
from tests.helpers.arm_rig import BOUNDS, NAMES, ArmRig
from tests.helpers.fake_arm import HOME
from tests.helpers.moveit import REGISTRY, ROBOT, DirectPool, box, diff
from tests.helpers.moveit import point as frame_point

# The planners' time for each question [s].
PLANNING_S = 0.02

DEFAULTS = Settings()

PAN = {"name": ["shoulder_pan"], "position": [0.4]}
ARM_JOINTS = ROBOT.groups["arm"].joints
COLUMNS = [NAMES.index(name) for name in ARM_JOINTS]
WAVE = TaughtMotion(ARM_JOINTS, np.arange(6) * 0.2, np.linspace(0.1, 0.3, 6)[:, np.newaxis] * np.ones(len(ARM_JOINTS)))
TRAJECTORY = {
    "joint_names": list(ARM_JOINTS),
    "points": [{"positions": [0.1, 0.0, 0.0, 0.0, 0.0], "time_from_start": {"sec": 2, "nanosec": 0}}],
}
CHUNK = {
    "joint_names": [*ARM_JOINTS, "gripper"],
    "points": [
        {
            "positions": [0.01 * step, 0.0, 0.0, 0.0, 0.0, 0.1],
            "time_from_start": {"sec": 0, "nanosec": 33_000_000 * step},
        }
        for step in range(1, 30)
    ],
}


class TimedPool(DirectPool):
    """Planner whose answers take time."""

    async def ask(self, request: Request, scene: Scene = EMPTY_SCENE) -> Answer:
        await asyncio.sleep(PLANNING_S)
        return await super().ask(request, scene)


class ServerStage:
    """Server without sockets, and a client."""

    def __init__(self, arm: Arm, settings: Settings = DEFAULTS) -> None:
        # Their time is that of the event loop.
        self.graph = Graph(REGISTRY, asyncio.get_running_loop().time)
        served = ServedArm("", settings.arm, Description("", ROBOT, HardwareTable(), None), arm)
        pool = cast("Planners", TimedPool())
        self.context = context_of(settings, self.graph, (served, (served,)), pool)
        self.teaching, self.teleoperation = teaching_of(self.context), teleoperation_of(self.context)
        self.commissioning = CommissioningOfArms(
            self.context, lambda _recalibrated: None, None, shared_calibration=False
        )
        of_arms = self.teaching, self.context.goals, Servo(self.context), self.teleoperation, PolicyChunks(self.context)
        goals = MoveGroup(self.context), ArmGoals(self.context), *of_arms
        self._features = ArmControl(self.context), Parkings(self.context), *goals, self.commissioning
        for feature in goals:
            at_once(feature.start())
        self.client = Node("client", remote=True)
        self.answers: list[Any] = []

    def take_state(self, state: ArmState) -> None:
        """Pass the arm's latest state on."""
        for feature in self._features:
            feature.on_state("", state)

    def publish(self, topic: str, type_name: str, message: dict[str, Any], sender: Node | None = None) -> None:
        node = sender or self.client
        if node not in self.graph.publishers(topic):
            self.graph.advertise(node, topic, type_name)
        self.graph.publish(node, topic, message)

    def call(self, service: str, **request: Any) -> None:
        self.graph.services.call(self.client, service, request, self.answers.append)

    def send(self, action: str, type_name: str, **goal: Any) -> None:
        self.graph.actions.send_goal(self.client, action, type_name, goal, self.answers.append)

    async def save_wave(self) -> None:
        """Save the motion that a replay plays."""
        await self.teaching._motions.save("wave", WAVE)

    async def close(self) -> None:
        """End everything."""
        for feature in reversed(self._features):
            if not isinstance(feature, Parkings):
                await feature.stop()


class RigProcess:
    """The process of :class:`RigArm`."""

    launched = configured = True
    pid = 7

    def __init__(self, rig: ArmRig) -> None:
        self._rig = rig

    def send(self, message: object) -> None:
        self._rig.supervisor.handle(message)  # type: ignore[arg-type]


class RigArm(Arm):
    """The arm as the server has it, whose process is a supervisor in the same event loop."""

    def __init__(self, settings: Settings) -> None:
        self.rig = ArmRig(robot=ROBOT, hardware=IdealConfig(lag_s=0.0)).started()
        super().__init__(self.rig.config, lambda state: self.stage.take_state(state))
        self._process = cast("ArmProcess", RigProcess(self.rig))
        self.stage = ServerStage(self, settings)
        self.rig.supervisor.handle(Stop(epoch=self.last_stop))

    async def run(self) -> None:
        """Have the arm's time pass with that of the event loop."""
        while True:
            sent, self.rig.sent[:] = [*self.rig.sent], []
            for message in sent:
                # Its ticks are at times of the event loop.
                at_s = asyncio.get_running_loop().time()
                self._received(replace(message, tick_s=at_s) if isinstance(message, ArmState) else message)
            await asyncio.sleep(PERIOD_S)
            self.rig.tick()

    @property
    def state_age_s(self) -> float:
        return 0.0


class RecordedStage:
    """Server with an arm whose goals are recorded, and a client of topics.

    Attributes:
        goals_rad: goals of all joints, one each tick, each of shape (joints,).
        refusals: of the client's messages.
    """

    def __init__(self) -> None:
        self.arm = RigArm(DEFAULTS)
        self.stage = self.arm.stage
        self.goals_rad: list[Vector] = []
        self.refusals: list[str] = []
        self._tick = self.arm.rig.tick
        self.arm.rig.tick = self._note  # type: ignore[method-assign]

    def _note(self) -> None:
        self._tick()
        controller = self.arm.rig.supervisor._controller
        assert controller is not None
        self.goals_rad.append(controller.goal_rad.copy())

    def publish_now(self, topic: str, type_name: str, message: dict[str, Any], sender: Node | None = None) -> None:
        """Publish a message, as in a frame that arrives now."""

        def arrive() -> None:
            with arrived_in(STOP_EPOCHS.present):
                self.stage.publish(topic, type_name, message, sender)

        try:
            Context().run(arrive)
        except Exception as error:  # noqa: BLE001 - any refusal is for the client
            self.refusals.append(str(error))

    @property
    def arm_rad(self) -> Vector:
        """Goals of the arm's joints, shape (ticks, joints) [rad]."""
        return np.array(self.goals_rad)[:, COLUMNS]

    @property
    def velocity_rad_s(self) -> Vector:
        """Velocities of the arm's goals, shape (ticks - 1, joints) [rad/s]."""
        return np.diff(self.arm_rad, axis=0) / PERIOD_S

    def assert_within_limits(self) -> None:
        """Assert that each tick keeps the limits of velocity and acceleration."""
        velocity = self.velocity_rad_s
        assert (np.abs(velocity) <= BOUNDS.max_velocity[COLUMNS] * VELOCITY_TOLERANCE).all()
        change = np.abs(np.diff(velocity, axis=0)) / PERIOD_S
        assert (change <= BOUNDS.max_acceleration[COLUMNS] * ACCELERATION_TOLERANCE).all()

    def add_walls(self, y_m: float = 0.2) -> None:
        """Put walls on both sides of the arm."""
        solid = {"type": 1, "dimensions": [0.5, 0.02, 0.4]}
        walls = [box(f"wall {y}", at=frame_point(0.2, y, 0.2), primitives=[solid]) for y in (-y_m, y_m)]
        self.stage.context.planning.scene_state.apply_diff(diff(world={"collision_objects": walls}), HOME)

    async def run(self) -> AsyncIterator[Self]:
        """Have time pass; for a fixture."""
        running = asyncio.create_task(self.arm.run())
        await asyncio.sleep(0.1)
        self.goals_rad.clear()
        yield self
        await self.stage.close()
        running.cancel()


def at_once(work: Coroutine[Any, Any, None]) -> None:
    """Do work that waits for nothing."""
    with pytest.raises(StopIteration):
        work.send(None)


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
    "a chunk": lambda stage: stage.send(
        "/arm/chunks", "armbridge_msgs/action/FollowActionChunk", chunk={"trajectory": CHUNK}
    ),
}


def inline_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the work of threads done by the event loop, a step later: stepped time waits for no thread."""

    async def run(work: Callable[..., Any], *arguments: Any) -> Any:
        await asyncio.sleep(0.01)
        return work(*arguments)

    monkeypatch.setattr(asyncio, "to_thread", run)
