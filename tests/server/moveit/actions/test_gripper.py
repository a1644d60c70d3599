import asyncio
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robot.description.limits import within_calibration
from robot.description.model import parse
from robot.description.urdf import Joint
from robot.messages import Mode, MotionEnded, MotionProgress, Outcome
from robot.trajectory import Trajectory
from server.errors import RefusedError
from server.execution.goal import BRAKING_TIMEOUT_S, TimeLimits
from server.execution.motions import MotionsInProgress
from server.graph.actions import Result
from server.graph.permissions import Node
from server.graph.topics import Graph, LocalGraph
from server.moveit.actions.gripper import (
    FETCH_ACTION,
    GRIPPER_ACTION,
    PARALLEL_ACTION,
    SQUEEZE_PERIOD_S,
    Gripper,
    GripperCommand,
    GripperCommandMessages,
    GripperReading,
    ParallelGripperCommandMessages,
    fingers_together,
    offer_gripper,
)
from tests.helpers.fake_arm import StubbornArm, settle
from tests.helpers.moveit import REGISTRY, goal_context
from tests.helpers.robots import LIFTED_SRDF, LIFTED_URDF, nominal_calibration, so101

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
SIMPLE, PARALLEL = "control_msgs/action/GripperCommand", "control_msgs/action/ParallelGripperCommand"
CALIBRATED = within_calibration(so101(), nominal_calibration())
JOINT = CALIBRATED.joints["gripper"]


class SlowArm(StubbornArm):
    """Moves its gripper for as long as a test lets it, whatever the torque, at a share of the planned speed."""

    rate = torque_share = 1.0

    def execute(self, trajectory: Trajectory, **options: Any) -> asyncio.Future[MotionEnded]:
        self.torque_share = options["torque_share"]
        return super().execute(trajectory, **options)

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
        full_speed = {"max_velocity_scaling": 1.0, "max_acceleration_scaling": 1.0}
        clock = asyncio.get_running_loop().time
        planning: Any = SimpleNamespace(time_limits=limits or TimeLimits(), clock=clock, robot=CALIBRATED)
        context = goal_context(self.graph, self.arm, planning, None, **full_speed)
        self.gripper = Gripper(context, [JOINT.name], 0.5, MotionsInProgress())
        offer_gripper(LocalGraph(self.graph), self.gripper)
        self.results: list[Result] = []
        self.feedback: list[dict[str, Any]] = []

    async def send(self, action: str = PARALLEL_ACTION, **command: Any) -> Any:
        """Send a goal, by default to the action that takes a velocity."""
        told = command if "position" in command else {"name": ["gripper"], "position": [1.0], **command}
        type_name, client = PARALLEL if action == PARALLEL_ACTION else SIMPLE, Node("client", remote=True)
        hear = self.results.append, self.feedback.append
        goal = self.graph.actions.send_goal(client, action, type_name, {"command": told}, *hear)
        await settle()
        return goal


@pytest.mark.stepped_time
async def test_feedback_and_result_tell_where_the_gripper_is_and_how_its_motion_ended() -> None:
    for end, status, end_rad, stalled in (
        (Outcome.REACHED, SUCCEEDED, 1.0, False),
        (Outcome.GRIPPED, SUCCEEDED, 0.2, True),
        (Outcome.STOPPED, CANCELED, 0.2, False),
    ):
        for action, command in ((FETCH_ACTION, {"position": 1.0, "max_effort": 0.1}), (PARALLEL_ACTION, {})):
            grippers = Grippers()
            grippers.arm.put(gripper=0.2)
            await grippers.send(action, **command)
            await asyncio.sleep(1.0)
            grippers.arm.end(end, "so")
            await together(grippers.arm, 1.0)
            (result,) = grippers.results
            told = [each if command else each["state"] for each in (grippers.feedback[0], result.values)]
            assert [each["position"] for each in told] == ([0.2, end_rad] if command else [[0.2], [end_rad]])
            flags = result.values["stalled"], result.values["reached_goal"]
            assert (result.status, *flags) == (status, stalled, end is Outcome.REACHED)
            # Of the limit of 0.5.
            assert grippers.arm.torque_share == (0.2 if command else 1.0), end


@pytest.mark.stepped_time
async def test_the_newest_of_several_goals_wins_and_one_that_is_cancelled_is_braked() -> None:
    grippers = Grippers()
    for position in (1.5, 0.1, 0.9):
        goal = await grippers.send(FETCH_ACTION, position=position)
    for stops in (1, 2):
        assert len(grippers.arm.stops) == stops
        grippers.arm.end(Outcome.STOPPED, "stopped half-way")
        await together(grippers.arm, 1.0)
        goal.cancel()
        await settle()
    assert [motion.positions_rad[-1, 0] for motion in grippers.arm.played] == pytest.approx([1.5, 0.9])
    assert [result.status for result in grippers.results] == [CANCELED] * 3


async def test_a_command_that_comes_while_the_arm_is_being_started_waits_for_it() -> None:
    grippers = Grippers()
    grippers.arm.started.clear()
    grippers.arm.state = replace(grippers.arm.state, mode=Mode.RELAXED)
    await grippers.send()
    assert grippers.results == []
    grippers.arm.started.set()
    await settle()
    (result,) = grippers.results
    assert (result.ok, result.status) == (False, ABORTED)
    assert "/arm/enable" in result.values


async def test_a_gripper_is_braked_when_its_goal_is_over_or_ends_by_an_error() -> None:
    grippers = Grippers()
    goal = await grippers.send()
    assert len(grippers.arm.played) == 1
    goal.fail("took more than 3600 s")
    await settle()
    assert len(grippers.arm.stops) == 1
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
async def test_a_gripper_has_its_time_by_the_arms_clock_and_is_braked_and_awaited_by_the_same() -> None:
    moving = begin(slow := SlowArm())
    await asyncio.sleep(100.0 * ALLOWED_S)
    await together(slow, 0.9 * ALLOWED_S)
    assert slow.stops == []
    slow.end()
    assert (await moving).outcome is Outcome.REACHED
    moving = begin(slow := SlowArm())
    await together(slow, 1.1 * ALLOWED_S)
    assert (len(slow.stops), moving.done()) == (1, False)
    await asyncio.sleep(100.0)
    assert not moving.done()
    await together(slow, BRAKING_TIMEOUT_S)
    assert (await moving).outcome is Outcome.PROCESS_LOST


@pytest.mark.stepped_time
async def test_a_goal_fails_at_its_deadline_with_the_limit() -> None:
    for rate, after_s, said in (
        (1.0, ALLOWED_S, "the arm did not end the motion within 5.0 s; stopped half-way"),
        (0.5, 2.0 * ALLOWED_S, "the arm did not end the motion within 5.0 s; stopped half-way"),
        (0.01, LIMITS.paused_s, "the motion was paused or going back for 20 s (limit 20 s); stopped half-way"),
    ):
        grippers = Grippers(LIMITS)
        grippers.arm.rate = rate
        await grippers.send()
        await together(grippers.arm, 0.95 * after_s)
        assert grippers.arm.stops == [], rate
        await together(grippers.arm, 0.05 * after_s + 0.2)
        assert len(grippers.arm.stops) == 1, rate
        grippers.arm.end(Outcome.STOPPED, "stopped half-way")
        await settle()
        assert grippers.results == [Result(ok=False, status=ABORTED, values=said)]


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


async def test_an_invalid_command_is_rejected_with_field_limit_and_value() -> None:
    for action, command, words in (
        (GRIPPER_ACTION, {"position": 5.0}, "from -0.145 to 1.715 rad, not 5.0"),
        (GRIPPER_ACTION, {"position": 1.0, "max_effort": -1.0}, "effort .* not -1.0"),
        (PARALLEL_ACTION, {"name": ["gripper"], "position": []}, "one value, not 0"),
        (PARALLEL_ACTION, {"name": ["elbow_flex"], "position": [0.1]}, "elbow_flex"),
        (PARALLEL_ACTION, {"position": [0.1], "effort": [0.1, 0.2]}, "command.effort .* not 2"),
    ):
        grippers = Grippers()
        await grippers.send(action, **command)
        (result,) = grippers.results
        assert (result.ok, result.status) == (False, ABORTED), action
        assert re.search(words, result.values)


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


def test_a_position_has_the_soft_limit_and_is_the_gap_between_two_sliding_fingers_in_metres() -> None:
    assert simple_command([JOINT], -0.174533).position == JOINT.lower > -0.17
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
