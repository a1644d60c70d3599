"""A stop at every moment: each kind of request that may move the arm is held up at each of its steps, and a stop comes.

The parts of the server are the real ones, in stepped time; the arm takes what the real one takes.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine, Generator
from contextlib import asynccontextmanager
from contextvars import Context
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from planners.pool import PlannerPool
from planners.problem import Answer, Request
from planners.scene import EMPTY_SCENE, Scene
from protocol.registry import Registry
from robot.messages import CommandDone, Mode, MotionEnded, Order, Setpoint
from robot.stop_epochs import STOP_EPOCHS
from robot.trajectory import Trajectory
from server import arrival
from server.arm.commissioning import Commissioning, Procedure
from server.arm.services import ArmServices
from server.arm.verifying import VerificationProcedure
from server.arrival import arrived_in
from server.config import ArmSettings, Settings
from server.execution.parking import Parking
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.interface import MoveItInterface
from server.teaching.taught_motion import TaughtMotion
from tests.helpers.fake_arm import FakeArm
from tests.helpers.moveit import ROBOT, DirectPool

pytestmark = pytest.mark.stepped_time

# Each motion of the arm, and the planners' time for each question [s].
MOTION_S = 0.4
PLANNING_S = 0.02

# Everything that a request begins is over by then, or goes on until it is stopped [s].
TRIAL_S = 4.0

# A following and a steered arm make a step every 10 ms; later steps are like these.
MOST_STEPS = 80

# To listen, to plan and make the way to the leader, and to begin to follow.
LEAST_STEPS_OF_FOLLOWING = 12

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


class TimedArm(FakeArm):
    """Arm whose motions end by themselves, and which notes every motion that it begins.

    Attributes:
        begun: motions, streams that moved and switches of torque since the last stop.
    """

    def __init__(self) -> None:
        super().__init__()
        self.begun: list[str] = []
        self.pid = 7

    def execute(self, trajectory: Trajectory, **options: Any) -> asyncio.Future[MotionEnded]:
        ended = super().execute(trajectory, **options)
        if not ended.done():
            self.begun.append(f"a motion of {', '.join(trajectory.joint_names)}")
            asyncio.get_running_loop().call_later(MOTION_S, self.end)
        return ended

    def order(self, order: Order, _calibration: object = None, epoch: int | None = None) -> asyncio.Future[CommandDone]:
        answered: asyncio.Future[CommandDone] = asyncio.get_running_loop().create_future()
        stopped = epoch is not None and epoch < self.last_stop
        if order is Order.ENABLE and not stopped:
            self.begun.append("torque on")
            self.state = replace(self.state, driven=True)
        done = CommandDone(0, done=not stopped, message="a stop came" if stopped else "done")
        asyncio.get_running_loop().call_later(0.01, answered.set_result, done)
        return answered

    def stop(self, motion: asyncio.Future[MotionEnded] | None = None) -> None:
        super().stop(motion)
        if motion is None:
            self.begun.clear()

    def take_setpoints(self) -> None:
        """Note the setpoints of streams that are not at rest."""
        moving, self.setpoints[:] = [each for each in self.setpoints if np.any(each.velocity_rad_s)], []
        self.begun += [f"a stream at {each.velocity_rad_s}" for each in cast("list[Setpoint]", moving)]

    async def rest(self, _timeout_s: float) -> bool:
        await asyncio.sleep(0.05)
        return True

    def keep_parking(self, plan: object) -> None:
        pass

    async def end_streams(self, _timeout_s: float) -> bool:
        await asyncio.sleep(0.01)
        return True


class SteppedCoroutine(Coroutine[Any, Any, Any]):
    """Coroutine that calls a function before each of its steps."""

    def __init__(self, coroutine: Generator[Any, Any, Any] | Coroutine[Any, Any, Any], before: Callable[[], None]):
        self._coroutine, self._before = coroutine, before

    def send(self, value: Any) -> Any:
        self._before()
        return self._coroutine.send(value)

    def throw(self, *error: Any) -> Any:
        return self._coroutine.throw(*error)

    def close(self) -> None:
        self._coroutine.close()

    def __await__(self) -> Generator[Any, Any, Any]:
        yield from ()


class Stage:
    """Server without sockets, a client that asks for one motion, and another client that stops the arm.

    Attributes:
        steps: steps of all tasks that the request has started.
    """

    def __init__(self) -> None:
        self.graph = Graph(Registry.load())
        self.arm, pool = TimedArm(), cast("PlannerPool", TimedPool())
        settings = Settings()
        self.moveit = MoveItInterface(self.graph, ROBOT, settings, lambda _name, _value: None, self.arm.as_arm, pool)
        parking = Parking(
            self.arm.as_arm, ROBOT, ArmSettings(), settings.moveit, pool, self.moveit.scene, self.moveit.queue
        )
        ArmServices(self.graph, self.arm.as_arm, self.moveit.stop, parking.park)
        self._commissioning = Commissioning(self.graph, self._verification)
        self.moveit.start()
        # Their time is that of the event loop.
        clock = asyncio.get_running_loop().time
        self.moveit.teleoperation._clock = self.moveit._servo._session._clock = clock
        self.client, self.other = Node("client", remote=True), Node("other", remote=True)
        self.answers: list[Any] = []
        self.steps = 0
        self._stop_at = 0
        self._stop: Callable[[], None] = lambda: None

    def _verification(self, _procedure: str, _name: str) -> Procedure:
        moveit = self.moveit
        return VerificationProcedure(self.arm.as_arm, ROBOT, frozenset(), moveit.go_to, moveit.queue.cancel)

    def publish(self, topic: str, type_name: str, message: dict[str, Any]) -> None:
        if self.client not in self.graph.publishers(topic):
            self.graph.advertise(self.client, topic, type_name)
        self.graph.publish(self.client, topic, message)

    def call(self, service: str, **request: Any) -> None:
        self.graph.services.call(self.client, service, request, self.answers.append)

    def send(self, action: str, type_name: str, **goal: Any) -> None:
        self.graph.actions.send_goal(self.client, action, type_name, goal, self.answers.append)

    def stop_by_topic(self) -> None:
        self.graph.publish(self.other, "/stop", {})

    def stop_by_service(self) -> None:
        self.graph.services.call(self.other, "/arm/stop", {}, lambda _response: None)

    def stop_following(self) -> None:
        self.graph.services.call(self.other, "/teleop/stop", {}, lambda _response: None)
        self.arm.begun.clear()

    def task(self, loop: asyncio.AbstractEventLoop, coroutine: Any, **options: Any) -> asyncio.Task[Any]:
        """Make the tasks of the event loop; those of the request count their steps."""
        if arrival._EPOCH.get() is not None:
            coroutine = SteppedCoroutine(coroutine, self._before_step)
        return asyncio.Task(coroutine, loop=loop, **options)

    def _before_step(self) -> None:
        self.steps += 1
        self.arm.take_setpoints()
        if self.steps == self._stop_at:
            # As by the frame of another client, in a context of its own.
            Context().run(self._stop)

    async def trial(self, request: Callable[[Stage], None], stop: Callable[[], None], stop_at: int) -> bool:
        """Make a request, and stop before one of its steps, 0 being before its handler runs.

        Returns:
            False when the request had fewer steps.
        """
        self._stop, self._stop_at, self.steps = stop, stop_at, 0
        epoch = STOP_EPOCHS.present
        if stop_at == 0:
            Context().run(stop)
        with arrived_in(epoch):
            request(self)
        # In the context of nothing: what goes on by itself is no part of the request.
        await asyncio.sleep(TRIAL_S)
        self.arm.take_setpoints()
        return self.steps >= stop_at

    def prepare(self) -> None:
        """Be at rest at home, relaxed, with nothing to do."""
        self.stop_by_topic()
        self.call("/servo_node/reset_servo_status")
        self.arm.put()
        self.arm.state = replace(self.arm.state, mode=Mode.HOLDING, driven=False)
        self.arm.begun.clear()
        self.arm.played.clear()


@asynccontextmanager
async def staged() -> AsyncIterator[Stage]:
    stage = Stage()
    await stage.moveit.teaching._motions.save("wave", WAVE)
    loop = asyncio.get_running_loop()
    loop.set_task_factory(stage.task)
    try:
        yield stage
    finally:
        loop.set_task_factory(None)
        await stage._commissioning.close()
        await stage.moveit.close()


def verify(stage: Stage) -> None:
    stage.call("/arm/commissioning/begin", procedure="verify", name="")
    loop = asyncio.get_running_loop()
    loop.call_later(0.05, lambda: stage.call("/arm/commissioning/answer", step="torque", answer="move"))


def follow(stage: Stage) -> None:
    """Follow a topic whose first sample comes later."""
    stage.call("/teleop/start", leader="/glove")

    async def lead() -> None:
        for number in range(100):
            await asyncio.sleep(0.02)
            stamp = {"sec": 5, "nanosec": 20_000_000 * (number % 50)} if number < 50 else {"sec": 6, "nanosec": 0}
            sample = {"header": {"stamp": stamp}, "name": ["shoulder_pan"], "position": [0.1 + 0.002 * number]}
            stage.publish("/glove", "sensor_msgs/JointState", sample)

    Context().run(lambda: stage.answers.append(asyncio.ensure_future(lead())))


def jog(stage: Stage) -> None:
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
REQUESTS: dict[str, Callable[[Stage], None]] = {
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


@pytest.mark.parametrize("request_", REQUESTS.values(), ids=REQUESTS.keys())
async def test_a_request_moves_the_arm_where_nobody_stops_it(
    request_: Callable[[Stage], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    inline_threads(monkeypatch)
    async with staged() as stage:
        await stage.trial(request_, stage.stop_by_topic, -1)
        assert stage.arm.begun


@pytest.mark.parametrize("request_", REQUESTS.values(), ids=REQUESTS.keys())
@pytest.mark.parametrize("by", ["topic", "service"])
async def test_nothing_moves_after_a_stop_whichever_step_of_a_request_it_comes_before(
    request_: Callable[[Stage], None], by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    inline_threads(monkeypatch)
    async with staged() as stage:
        stop = stage.stop_by_topic if by == "topic" else stage.stop_by_service
        for stop_at in range(MOST_STEPS):
            stage.prepare()
            if not await stage.trial(request_, stop, stop_at):
                assert stop_at > 0
                return
            assert stage.arm.begun == [], f"after a stop before step {stop_at}"


@pytest.mark.parametrize("by", ["teleop", "topic"])
async def test_nothing_follows_after_a_stop_whichever_step_of_the_start_it_comes_before(
    by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    inline_threads(monkeypatch)
    async with staged() as stage:
        stop = stage.stop_following if by == "teleop" else stage.stop_by_topic
        for stop_at in range(MOST_STEPS):
            stage.prepare()
            if not await stage.trial(follow, stop, stop_at):
                # The leader has left, to which the arm had gone before.
                assert stop_at > LEAST_STEPS_OF_FOLLOWING
                return
            assert not stage.moveit.teleoperation.active, f"after a stop before step {stop_at}"
