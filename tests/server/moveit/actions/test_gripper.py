import asyncio
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from harness.clients import ArmClient
from harness.server import ServerOnBus
from harness.waiting import TIMEOUT_S
from robot.arm import Arm
from robot.description.limits import within_calibration
from robot.description.model import parse
from robot.description.urdf import Joint
from robot.hardware.config import SerialConfig
from robot.messages import ArmConfig, Mode, MotionEnded, MotionProgress, Outcome
from server.errors import RefusedError
from server.execution.goal import TimeLimits
from server.execution.player import BRAKING_TIMEOUT_S
from server.graph.actions import Result
from server.graph.local_graph import LocalGraph
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.actions.gripper import (
    GRIPPER_ACTION,
    PARALLEL_ACTION,
    SQUEEZE_PERIOD_S,
    Gripper,
    GripperCommand,
    GripperCommandMessages,
    GripperLimits,
    GripperReading,
    ParallelGripperCommandMessages,
    fingers_together,
    offer_gripper,
)
from tests.helpers.fake_arm import StubbornArm, settle
from tests.helpers.moveit import REGISTRY
from tests.helpers.robots import LIFTED_SRDF, LIFTED_URDF, nominal_calibration, so101
from tests.server.conftest import JOINTS

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
SIMPLE, PARALLEL = "control_msgs/action/GripperCommand", "control_msgs/action/ParallelGripperCommand"
JOINT = within_calibration(so101(), nominal_calibration()).joints["gripper"]


async def send(client: ArmClient, position_rad: float, max_effort: float = 0.0) -> str:
    command = {"position": position_rad, "max_effort": max_effort}
    return await client.send_goal(GRIPPER_ACTION, SIMPLE, {"command": command})


async def move(client: ArmClient, position_rad: float, max_effort: float = 0.0) -> dict[str, Any]:
    return await client.result(await send(client, position_rad, max_effort))


async def test_the_gripper_opens_and_closes_by_both_actions_with_feedback(client: ArmClient) -> None:
    await move(client, 0.0)
    goal = await send(client, 1.2)
    ended = await client.result(goal)
    assert (ended["status"], ended["values"]["reached_goal"]) == (SUCCEEDED, True)
    assert ended["values"]["position"] == pytest.approx(1.2, abs=0.06)
    way = [feedback["position"] for feedback in client.feedback[goal]]
    assert way == sorted(way)
    command = {"name": ["gripper"], "position": [0.8], "effort": [0.3], "velocity": [2.0]}
    ended = await client.result(await client.send_goal(PARALLEL_ACTION, PARALLEL, {"command": command}))
    assert (ended["status"], ended["values"]["reached_goal"]) == (SUCCEEDED, True)
    assert ended["values"]["state"]["name"] == ["gripper"]
    assert ended["values"]["state"]["position"][0] == pytest.approx(0.8, abs=0.06)


async def test_an_object_in_the_jaws_is_gripped_gently_and_released(client: ArmClient, served: ServerOnBus) -> None:
    await move(client, 1.2)
    served.emulator.command(obstacle={"6": JOINTS["gripper"].ticks_from_rad(0.5)})
    ended = await move(client, 0.0, max_effort=0.4)
    values = ended["values"]
    assert (ended["status"], values["stalled"], values["reached_goal"]) == (SUCCEEDED, True, False)
    assert values["position"] == pytest.approx(0.5, abs=0.05)
    seen = len(client.topics["/joint_states"])
    states = await client.until("/joint_states", lambda states: len(states) > seen)
    assert abs(states[-1]["effort"][-1]) <= 0.3
    assert (await move(client, 1.2))["values"]["reached_goal"]
    await client.until_mode("holding")


async def test_the_newest_of_several_goals_wins_and_one_that_is_cancelled_stops_on_its_way(client: ArmClient) -> None:
    await move(client, 0.0)
    goals = [await send(client, position_rad) for position_rad in (1.5, 0.1, 0.9)]
    ends = [await client.result(goal) for goal in goals]
    assert [end["status"] for end in ends] == [CANCELED, CANCELED, SUCCEEDED]
    assert ends[-1]["values"]["position"] == pytest.approx(0.9, abs=0.06)
    goal = await send(client, 0.0)
    await client.until("/joint_states", lambda states: states[-1]["position"][-1] < 0.7)
    await client.say("cancel_action_goal", action=GRIPPER_ACTION, id=goal)
    ended = await client.result(goal)
    assert ended["status"] == CANCELED
    assert 0.05 < ended["values"]["position"] < 0.7


async def test_gripper_and_arm_move_at_the_same_time(client: ArmClient) -> None:
    await move(client, 0.0)
    pan_rad = (await client.until("/joint_states", bool))[-1]["position"][0]
    goal = {"name": ["shoulder_pan"], "position": [-1.0 if pan_rad > 0.0 else 1.0]}
    await client.goal("/moveit_goal_joints", "sensor_msgs/JointState", goal)
    await client.until("/joint_states", lambda states: abs(states[-1]["position"][0] - pan_rad) > 0.1)
    assert (await move(client, 1.0))["values"]["reached_goal"]
    assert (await client.until("/moveit_goal_result", bool))[0]["val"] == 1


async def test_a_command_that_comes_while_the_arm_is_being_started_waits_for_it() -> None:
    arm = Arm(ArmConfig(so101(), SerialConfig(nominal_calibration(), "/dev/nothing")), lambda _state: None)
    await arm.launch()
    gripper = Gripper(arm, [JOINT], GripperLimits(1.0, 1.0, 0.5, TimeLimits()))
    moving = asyncio.create_task(gripper.move(gripper.claim(), GripperCommand(1.0), lambda _reading: None))
    await settle()
    assert not moving.done()
    await arm.start(TIMEOUT_S)
    with pytest.raises(RefusedError, match="/dev/nothing does not exist"):
        await asyncio.wait_for(moving, TIMEOUT_S)
    await arm.close()


class SlowArm(StubbornArm):
    """Moves its gripper for as long as a test lets it, whatever the torque, at a share of the planned speed."""

    rate = 1.0

    def progress(self, motion: asyncio.Future[MotionEnded]) -> MotionProgress | None:
        progress = super().progress(motion)
        return None if progress is None else replace(progress, rate=self.rate)


ALLOWED_S = 5.0
LIMITS = TimeLimits(0.0, ALLOWED_S, paused_s=20.0)


def begin(arm: SlowArm) -> asyncio.Task[MotionEnded]:
    gripper = Grippers(LIMITS, arm).gripper
    return asyncio.create_task(gripper.move(gripper.claim(), GripperCommand(1.0), lambda _reading: None))


async def together(arm: SlowArm, seconds: float) -> None:
    """Let the same time pass here and on the arm's clock."""
    until_s = arm.clock_s + seconds
    while arm.clock_s < until_s:
        await asyncio.sleep(SQUEEZE_PERIOD_S)
        arm.pass_time(SQUEEZE_PERIOD_S)


class Grippers:
    """The gripper's actions on a graph, for an arm whose motions end when a test says so."""

    def __init__(self, limits: TimeLimits | None = None, arm: SlowArm | None = None) -> None:
        self.arm, self.graph = arm or SlowArm(), Graph(REGISTRY)
        self.arm.state = replace(self.arm.state, load=np.zeros(len(self.arm.state.joint_names)))
        limits_of_gripper = GripperLimits(1.0, 1.0, 0.5, limits or TimeLimits())
        clock = asyncio.get_running_loop().time
        self.gripper = Gripper(self.arm.as_arm, [JOINT], limits_of_gripper, clock=clock)
        offer_gripper(LocalGraph(self.graph), self.gripper)
        self.results: list[Result] = []

    async def send(self, action: str = PARALLEL_ACTION, **command: Any) -> Any:
        """Send a goal, by default to the action that takes a velocity."""
        told = command if "position" in command else {"name": ["gripper"], "position": [1.0], **command}
        type_name, client = PARALLEL if action == PARALLEL_ACTION else SIMPLE, Node("client", remote=True)
        goal = self.graph.actions.send_goal(client, action, type_name, {"command": told}, self.results.append)
        await settle()
        return goal


async def test_a_goal_that_is_over_takes_the_grippers_motion_along() -> None:
    grippers = Grippers()
    goal = await grippers.send()
    assert len(grippers.arm.played) == 1
    goal.fail("took more than 3600 s")
    await settle()
    assert len(grippers.arm.stops) == 1


async def test_a_gripper_whose_goal_ends_by_an_error_is_braked() -> None:
    grippers = Grippers()

    def broken(_reading: GripperReading) -> None:
        raise ValueError("a bug")

    with pytest.raises(ValueError, match="a bug"):
        await grippers.gripper.move(grippers.gripper.claim(), GripperCommand(1.0), broken)
    assert len(grippers.arm.stops) == 1


@pytest.mark.parametrize(("velocity", "told"), [(1e-3, "1000"), (5e-324, "1e+08")])
async def test_a_gripper_motion_that_takes_too_long_is_refused(velocity: float, told: str) -> None:
    grippers = Grippers()
    await grippers.send(velocity=[velocity])
    (result,) = grippers.results
    assert not result.ok
    assert f"the duration of the way to 1.000 rad is {told}" in result.values
    assert "longer than goals.max_trajectory_duration_s = 600: raise the command's velocity" in result.values
    assert grippers.arm.played == []


async def test_the_end_of_the_grippers_motion_is_known_by_time_and_position() -> None:
    grippers = Grippers()
    assert grippers.gripper.remaining_s is None
    await grippers.send(velocity=[0.01])
    assert grippers.gripper.remaining_s == pytest.approx(100.0, abs=1.0)
    in_progress = grippers.gripper._in_progress
    assert in_progress.expected_rad({"gripper": 0.0}, frozenset(("elbow_flex",))) == {"gripper": 1.0}
    grippers.arm.end()
    await settle()
    assert grippers.gripper.remaining_s is None


@pytest.mark.stepped_time
async def test_a_starved_gripper_has_all_its_time_by_the_arms_clock() -> None:
    moving = begin(slow := SlowArm())
    await asyncio.sleep(100.0 * ALLOWED_S)
    await together(slow, 0.9 * ALLOWED_S)
    assert slow.stops == []
    slow.end()
    assert (await moving).outcome is Outcome.REACHED


@pytest.mark.stepped_time
@pytest.mark.parametrize(
    ("rate", "after_s", "said"),
    [
        (1.0, ALLOWED_S, "the arm did not end the motion within 5.0 s; stopped half-way"),
        (0.5, 2.0 * ALLOWED_S, "the arm did not end the motion within 5.0 s; stopped half-way"),
        (0.01, LIMITS.paused_s, "the motion was paused or going back for 20 s (limit 20 s); stopped half-way"),
    ],
)
async def test_a_goal_fails_at_its_deadline_with_the_limit(rate: float, after_s: float, said: str) -> None:
    grippers = Grippers(LIMITS)
    grippers.arm.rate = rate
    await grippers.send()
    await together(grippers.arm, 0.95 * after_s)
    assert grippers.arm.stops == []
    await together(grippers.arm, 0.05 * after_s + 0.2)
    assert len(grippers.arm.stops) == 1
    grippers.arm.end(Outcome.STOPPED, "stopped half-way")
    await settle()
    assert grippers.results == [Result(ok=False, status=ABORTED, values=said)]


@pytest.mark.stepped_time
async def test_a_gripper_that_overruns_by_the_arms_clock_is_braked_and_awaited_by_the_same() -> None:
    moving = begin(slow := SlowArm())
    await together(slow, 1.1 * ALLOWED_S)
    assert (len(slow.stops), moving.done()) == (1, False)
    await asyncio.sleep(100.0)
    assert not moving.done()
    await together(slow, BRAKING_TIMEOUT_S)
    assert (await moving).outcome is Outcome.PROCESS_LOST


@pytest.mark.stepped_time
async def test_a_grip_ends_when_its_goal_position_rests_by_the_arms_clock() -> None:
    moving = begin(slow := SlowArm())
    await settle()
    for goal_rad in (0.9, 0.6, 0.5):
        slow.put(gripper=goal_rad)
        slow.end(Outcome.GRIPPED, "gripped something")
        await asyncio.sleep(10.0)
        assert not moving.done()
        slow.pass_time(1.1 * SQUEEZE_PERIOD_S)
    assert (await moving).outcome is Outcome.GRIPPED


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    (GRIPPER_ACTION, {"position": 5.0}, "from -0.145 to 1.715 rad, not 5.0"),
    (GRIPPER_ACTION, {"position": 1.0, "max_effort": -1.0}, "effort .* not -1.0"),
    (PARALLEL_ACTION, {"name": ["gripper"], "position": []}, "one value, not 0"),
    (PARALLEL_ACTION, {"name": ["elbow_flex"], "position": [0.1]}, "elbow_flex"),
    (PARALLEL_ACTION, {"position": [0.1], "effort": [0.1, 0.2]}, "command.effort .* not 2"),
]


@pytest.mark.parametrize(("action", "command", "words"), REFUSED)
async def test_an_invalid_command_is_rejected_with_field_limit_and_value(
    action: str, command: dict[str, Any], words: str
) -> None:
    grippers = Grippers()
    await grippers.send(action, **command)
    (result,) = grippers.results
    assert (result.ok, result.status) == (False, ABORTED)
    assert re.search(words, result.values)


async def test_a_relaxed_gripper_names_the_service_that_enables_it() -> None:
    grippers = Grippers()
    grippers.arm.state = replace(grippers.arm.state, mode=Mode.RELAXED)
    await grippers.send()
    (result,) = grippers.results
    assert (result.ok, result.status) == (False, ABORTED)
    assert "/arm/enable" in result.values


LIFTED = parse(LIFTED_URDF, LIFTED_SRDF)
FINGERS = [LIFTED.joints[name] for name in LIFTED.groups["gripper"].joints]


def test_fingers_arrive_together_wherever_each_of_them_is() -> None:
    motion = fingers_together(("a", "b"), np.array([0.0, 0.03]), 0.05, 0.1, 1.0)
    assert motion.positions_rad[-1].tolist() == pytest.approx([0.05, 0.05])
    share = (motion.positions_rad - motion.positions_rad[0]) / (motion.positions_rad[-1] - motion.positions_rad[0])
    np.testing.assert_allclose(share[:, 0], share[:, 1])
    assert np.abs(motion.velocities_rad_s).max() <= 0.1 + 1e-9
    assert fingers_together(("a", "b"), np.array([0.05, 0.05]), 0.05, 0.1, 1.0).duration_s == 0.0


def simple_command(joints: list[Joint], position: float) -> GripperCommand:
    return GripperCommandMessages(joints).command({"position": position, "max_effort": 0.0})


def test_the_urdfs_limit_means_the_soft_limit() -> None:
    assert simple_command([JOINT], -0.174533).position == JOINT.lower > -0.17


def test_the_position_of_two_sliding_fingers_is_the_gap_between_them_in_metres() -> None:
    assert simple_command(FINGERS, 0.06).position == pytest.approx(0.03)
    reading = GripperReading((0.02, 0.03), (0.0, 0.0), (0.1, -0.4))
    result = GripperCommandMessages(FINGERS).result(reading, stalled=False, reached=True)
    assert (result["position"], result["effort"]) == (pytest.approx(0.05), -0.4)
    with pytest.raises(RefusedError, match=r"must be from 0\.000 to 0\.100 m, not 0\.2"):
        simple_command(FINGERS, 0.2)


def test_each_finger_may_be_named_with_the_same_position() -> None:
    def command(**fields: Any) -> GripperCommand:
        return ParallelGripperCommandMessages(FINGERS).command({"name": [], "velocity": [], "effort": [], **fields})

    names = [joint.name for joint in FINGERS]
    assert command(name=names, position=[0.02, 0.02], velocity=[0.05, 0.04]) == GripperCommand(0.02, 0.0, 0.04)
    assert command(position=[0.02]) == GripperCommand(0.02)
    with pytest.raises(RefusedError, match="must be the same for all fingers"):
        command(name=names, position=[0.02, 0.03])
