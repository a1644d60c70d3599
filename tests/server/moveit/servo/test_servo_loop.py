"""The servo loop and the commands it follows."""

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from harness.waiting import until
from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Pose
from planners.servo.question import Anchor, JointVelocities, ServoAnswer, ServoLimits, ServoQuestion, ServoStatus
from robot.control.motion import SETPOINT_LASTS_S
from robot.messages import MotionEnded, Outcome, Setpoint
from server.errors import refused
from server.execution.monitors import CurrentState
from server.moveit.parameters import ServoParameters
from server.moveit.servo import servo_loop
from tests.helpers.clock import FakeClock
from tests.helpers.fake_arm import ROBOT, FakeArm
from tests.helpers.moveit import message, outcome

UNITLESS = ServoParameters(linear_scale=0.2, rotational_scale=0.8, joint_scale=0.5)
SPEEDS = ServoParameters(command_in_type="speed_units")
STEERED_JOINTS = ("shoulder_pan", "elbow_flex")


def twist(linear: dict[str, float], angular: dict[str, float] | None = None) -> Any:
    return message("geometry_msgs/TwistStamped", twist={"linear": linear, "angular": angular or {}})


def jog(names: list[str], velocities: list[float], **more: Any) -> Any:
    return message("control_msgs/JointJog", joint_names=names, velocities=velocities, **more)


def test_unitless_commands_are_scaled_to_speeds() -> None:
    read = servo_loop.read_twist(twist({"x": 0.5}, angular={"z": -1.0}), UNITLESS)
    assert isinstance(read, servo_loop.TwistCommand)
    assert read.linear_m_s == pytest.approx((0.1, 0.0, 0.0))
    assert read.angular_rad_s == pytest.approx((0.0, 0.0, -0.8))
    steered = servo_loop.read_joint_jog(jog(["elbow_flex"], [0.5]), STEERED_JOINTS, UNITLESS)
    assert steered == JointVelocities({"elbow_flex": 0.25})


ELBOW = ["elbow_flex"]
BAD: list[tuple[Any, Any, str]] = [
    (UNITLESS, twist({"y": 1.5}), "twist.linear.y must be -1 to 1"),
    (UNITLESS, twist({}, angular={"x": math.nan}), "twist.angular.x must be a finite number, not nan"),
    (SPEEDS, twist({"z": math.inf}), "twist.linear.z"),
    (UNITLESS, jog(ELBOW, []), "0 values for 1 joint_names"),
    (UNITLESS, jog([], []), "0 values for 0 joint_names"),
    (UNITLESS, jog(ELBOW, [], displacements=[0.1]), "displacements are not followed"),
    (UNITLESS, jog(["gripper"], [0.1]), "'gripper'"),
    (UNITLESS, jog(ELBOW * 2, [0.1, 0.2]), "twice"),
    (UNITLESS, jog(ELBOW, [math.nan]), "velocities of elbow_flex"),
]


@pytest.mark.parametrize(("parameters", "command", "said"), BAD)
def test_a_bad_command_is_rejected_with_field_and_value(parameters: Any, command: Any, said: str) -> None:
    jogs = (STEERED_JOINTS,) if "joint_names" in command else ()
    read = outcome(servo_loop.read_joint_jog if jogs else servo_loop.read_twist, command, *jogs, parameters)
    assert isinstance(read, PlanningFailure)
    assert said in read.message


JOINTS = ROBOT.groups["arm"].joints
PERIOD_S, TIMEOUT_S = 0.02, 0.25
NORTH, STILL = (servo_loop.TwistCommand((speed, 0.0, 0.0), (0.0, 0.0, 0.0), "") for speed in (0.1, 0.0))
MOVING = dict.fromkeys(JOINTS, 0.1) | {"elbow_flex": 0.3}
RESTING = dict.fromkeys(JOINTS, 0.0)
KEPT = Anchor(Pose((0.3, 0.0, 0.2)))


class Rig:
    """A session whose planners move every joint while anything is wanted; each answer takes a period."""

    def __init__(self, period_s: float = PERIOD_S, *, at_once: bool = False) -> None:
        self.arm, self.clock = FakeArm(), FakeClock()
        self.questions: list[ServoQuestion] = []
        self.told: list[tuple[ServoStatus, str]] = []
        self.interruptions: list[str] = []
        self.answer: Callable[[ServoQuestion], ServoAnswer | PlanningFailure] = lambda question: ServoAnswer(
            RESTING if question.command.zero else MOVING, anchor=KEPT
        )
        self._setup = servo_loop.ServoSetup(
            "arm", JOINTS, "gripper_frame_link", ServoLimits(), period_s, TIMEOUT_S, at_once
        )
        self.session = self.made(self._ask)

    def made(self, ask: servo_loop.Ask) -> servo_loop.ServoSession:
        """Return a session of its own with these planners."""
        frames: Any = SimpleNamespace(resolve=self._resolve)
        context: Any = SimpleNamespace(frames=frames, current=CurrentState(self.arm), clock=self.clock)
        listeners = lambda *told: self.told.append(told), self.interruptions.append
        return servo_loop.ServoSession(self.arm.as_arm, self._setup, context, *listeners, ask)

    async def until_let_go(self) -> None:
        await until(lambda: self.session._task is None)

    async def until_asked(self, times: int) -> None:
        await until(lambda: len(self.questions) >= times)

    async def _ask(self, question: ServoQuestion) -> ServoAnswer | PlanningFailure:
        self.questions.append(question)
        self.clock.advance(PERIOD_S)
        await asyncio.sleep(0)
        return self.answer(question)

    def _resolve(self, frame_id: str, _positions: object) -> Pose:
        if frame_id == "nowhere":
            raise refused(MoveItErrorCode.FRAME_TRANSFORM_FAILURE, "there is no frame 'nowhere'")
        return Pose()


@pytest.fixture
def rig() -> Rig:
    return Rig()


async def test_a_command_is_followed_at_once_where_the_loop_is_made_for_that() -> None:
    rig = Rig(period_s=1000.0, at_once=True)
    rig.session.set_command(NORTH)
    await rig.until_asked(1)
    rig.session.set_command(JointVelocities({"elbow_flex": 0.2}))
    await rig.until_asked(2)
    assert rig.questions[1].command == JointVelocities({"elbow_flex": 0.2})
    await rig.session.close()


async def test_an_ended_stream_ends_a_loop_and_has_nobody_let_go_after_a_pause_of_the_servers_own() -> None:
    for how, interruptions in ((Outcome.STOPPED, ["steering was ended: so"]), (Outcome.UNSTEERED, [])):
        rig = Rig(period_s=1000.0)
        rig.session.set_command(NORTH)
        await rig.until_asked(1)
        rig.arm.streams[0].ended.set_result(MotionEnded(0, how, "so"))
        await rig.until_let_go()
        assert rig.told[-1] == (ServoStatus.INVALID, "steering was ended: so"), how
        assert rig.interruptions == interruptions


@pytest.mark.parametrize(("timeout_s", "lasts_s"), [(math.inf, TIMEOUT_S), (0.08, 0.08)])
async def test_a_command_expires_and_then_the_arm_is_released(rig: Rig, timeout_s: float, lasts_s: float) -> None:
    rig.session.set_command(NORTH, timeout_s)
    await rig.until_let_go()
    moving = [bool(setpoint.velocity_rad_s.any()) for setpoint in rig.arm.setpoints]
    assert moving.count(True) == pytest.approx(lasts_s / PERIOD_S, abs=1.5)
    assert moving.count(False) == pytest.approx(servo_loop.REST_S / PERIOD_S, abs=1.5)
    assert rig.told[-1] == (ServoStatus.NO_WARNING, "")
    assert not rig.interruptions


async def test_a_release_before_the_loop_runs_moves_nothing(rig: Rig) -> None:
    rig.session.set_command(NORTH)
    rig.session.release()
    await rig.until_let_go()
    assert all(question.command.zero for question in rig.questions)


async def test_every_question_has_velocity_and_anchor_of_the_last_answer(rig: Rig) -> None:
    rig.session.set_command(NORTH)
    await rig.until_asked(2)
    assert (rig.questions[0].velocity_rad_s, rig.questions[0].anchor) == ({}, None)
    assert (rig.questions[1].velocity_rad_s, rig.questions[1].anchor) == (MOVING, KEPT)
    await rig.session.close()


async def test_a_failure_of_the_planners_halts_the_arm_with_its_message(rig: Rig) -> None:
    rig.answer = lambda _question: PlanningFailure(MoveItErrorCode.CRASH, "the planner process ended")
    rig.session.set_command(NORTH)
    await rig.until_asked(2)
    assert not rig.arm.setpoints[0].velocity_rad_s.any()
    assert rig.told[0] == (ServoStatus.INVALID, "the planner process ended")
    await rig.session.close()


@pytest.mark.stepped_time
async def test_while_an_answer_is_late_the_stream_is_kept_and_then_brakes(rig: Rig) -> None:
    loop = asyncio.get_running_loop()
    sent: list[tuple[float, bool]] = []

    def send(setpoint: Setpoint) -> None:
        sent.append((loop.time(), bool(setpoint.velocity_rad_s.any())))

    async def ask(_question: ServoQuestion) -> ServoAnswer:
        await asyncio.sleep(0.02 if len(sent) < 3 else 1.0)
        return ServoAnswer(MOVING, anchor=KEPT)

    rig.arm.setpoints = cast("Any", SimpleNamespace(append=send))
    rig.clock = cast("Any", loop.time)
    session = rig.made(ask)
    session.set_command(NORTH, math.inf)
    await asyncio.sleep(0.5)
    await session.close()
    gaps_s = np.diff([at_s for at_s, _ in sent])
    assert gaps_s.max() < SETPOINT_LASTS_S
    late = [moves for at_s, moves in sent if at_s > sent[2][0] + 0.15]
    assert late
    assert not any(late)
    assert any(moves for _, moves in sent[:4])


async def test_letting_go_while_an_answer_is_late_brakes_without_it(rig: Rig) -> None:
    asked, late = asyncio.Event(), asyncio.Event()

    async def ask(_question: ServoQuestion) -> ServoAnswer:
        if len(rig.arm.setpoints) >= 2:
            asked.set()
            await late.wait()
        return ServoAnswer(MOVING, anchor=KEPT)

    session = rig.made(ask)
    session.set_command(NORTH)
    await asked.wait()
    session.set_command(STILL)
    assert not rig.arm.setpoints[-1].velocity_rad_s.any()
    before = len(rig.arm.setpoints)
    late.set()
    await until(lambda: len(rig.arm.setpoints) > before + 1)
    assert not any(setpoint.velocity_rad_s.any() for setpoint in rig.arm.setpoints[before:])
    await session.close()


async def test_an_unknown_frame_moves_nothing(rig: Rig) -> None:
    rig.session.set_command(replace(NORTH, frame_id="nowhere"))
    await until(lambda: len(rig.told) >= 2)
    assert not any(setpoint.velocity_rad_s.any() for setpoint in rig.arm.setpoints)
    assert set(rig.told) == {(ServoStatus.INVALID, "there is no frame 'nowhere'")}
    await rig.session.close()


@pytest.mark.parametrize("halt", [STILL, JointVelocities({})])
async def test_a_halt_waits_for_no_planner_and_no_step(halt: servo_loop.ServoInput) -> None:
    rig = Rig(period_s=1000.0)
    rig.session.set_command(NORTH)
    await until(lambda: rig.told)
    assert rig.arm.setpoints[-1].velocity_rad_s.any()
    rig.session.set_command(halt)
    assert not rig.arm.setpoints[-1].velocity_rad_s.any()
    await rig.session.close()


async def test_a_bug_releases_the_arm(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    def broken(_question: ServoQuestion) -> ServoAnswer:
        raise AssertionError("broken")

    rig.answer = broken
    rig.session.set_command(NORTH)
    await rig.until_let_go()
    assert rig.arm.streams[0].ended.done()
    assert rig.told[-1][0] is ServoStatus.INVALID
    assert "steering failed" in caplog.text
