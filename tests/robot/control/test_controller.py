import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.control.controller import ArmController
from robot.control.guards import ActuatorThresholds
from robot.description.limits import JointBounds
from robot.faults import Fault, FaultCode
from robot.hardware.interface import Actuation, Measured
from robot.messages import (
    ChangePace,
    Continuation,
    Execute,
    GuardLimits,
    Mode,
    MotionEnded,
    Outcome,
    Pace,
    PlaybackDirection,
    Setpoint,
    Stream,
)
from robot.trajectory import Trajectory
from tests.helpers.arm_rig import NAMES, guards, reading
from tests.helpers.motions import smooth_move
from tests.helpers.robots import so101

BOUNDS = JointBounds.of(so101(), NAMES)
PERIOD_S = 0.01

# Greatest speed of a goal, as a share of the joint's velocity limit.
STEP_MARGIN = 1.5
LIMITS = GuardLimits()


class Rig:
    """A controller, its clock, and an arm that follows its goals exactly."""

    def __init__(
        self,
        hold_rad: list[float] | None = None,
        measured: Measured | None = None,
        *,
        actuation: Actuation | None = None,
    ) -> None:
        self.now_s = 100.0
        full_torque = np.array([0.8] * 5 + [0.5])
        thresholds = None if actuation is None else ActuatorThresholds.of(LIMITS, actuation, full_torque)
        checks = guards(thresholds=thresholds)
        self.controller = ArmController(NAMES, BOUNDS, checks, full_torque)
        self.controller.hold(np.array(hold_rad or [0.0] * 6), measured)
        self.goals = [self.controller.goal_rad]
        self.controller.step(reading(self.controller.goal_rad), self.now_s)
        self.goals.append(self.controller.goal_rad)

    def tick(
        self, lag: np.ndarray | None = None, age_s: float = 0.0, gap_s: float = PERIOD_S, **readings: object
    ) -> MotionEnded | None:
        self.now_s += gap_s
        position = self.controller.goal_rad + (0.0 if lag is None else lag)
        ages_s = [0.0, 0.0, age_s, 0.0, 0.0, 0.0]
        ended = self.controller.step(reading(position, age_s=ages_s, **readings), self.now_s)
        self.goals.append(self.controller.goal_rad)
        assert len(ended) <= 1
        return ended[0] if ended else None

    def run(self, ticks: int, **tick: object) -> None:
        for _ in range(ticks):
            self.tick(**tick)  # type: ignore[arg-type]

    def move_pan(self, ticks: int, number: int = 1) -> None:
        """Begin to move the pan to 1 within 2 s, for some ticks."""
        assert self.controller.execute(Execute(number, PAN)) is None
        self.run(ticks)

    def until_end(self, **tick: object) -> tuple[MotionEnded, float]:
        """The end of the motion, and the time it took [s]."""
        started_s = self.now_s
        for _ in range(2000):
            ended = self.tick(**tick)  # type: ignore[arg-type]
            if ended is not None:
                return ended, self.now_s - started_s
        raise AssertionError("the motion never ended")

    def largest_step(self) -> np.ndarray:
        return np.abs(np.diff(np.array(self.goals), axis=0)).max(axis=0)


def move(**joints: tuple[float, float]) -> Trajectory:
    return smooth_move(joints, duration_s=2.0)


PAN = move(shoulder_pan=(0.0, 1.0))


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_a_goal_found_far_from_the_arm_comes_back_to_it_within_the_step_bound_and_moves_again() -> None:
    rig = Rig([0.5, 0.02, 0, 0, 0, 0], reading(np.zeros(6)))
    for _ in range(200):
        rig.tick(lag=-rig.controller.goal_rad)
    assert rig.controller.goal_rad == pytest.approx([0.0, 0.02, 0, 0, 0, 0])
    assert (rig.largest_step() <= BOUNDS.max_velocity * PERIOD_S * STEP_MARGIN + 1e-9).all()
    rig.controller.execute(Execute(1, PAN))
    assert rig.until_end()[0].outcome is Outcome.REACHED
    assert rig.controller.goal_rad[0] == pytest.approx(1.0)


def test_an_arm_that_stays_behind_ends_the_motion_and_is_held_where_it_is(rig: Rig) -> None:
    rig.controller.execute(Execute(1, move(elbow_flex=(0.0, 1.0))))
    blocked = np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
    for _ in range(300):
        if ended := rig.tick(lag=blocked - rig.controller.goal_rad):
            break
    assert ended.outcome is Outcome.TRACKING_LOST
    assert "elbow_flex" in ended.message
    rig.run(200)
    assert rig.controller.goal_rad == pytest.approx(blocked)
    assert (rig.largest_step() <= BOUNDS.max_velocity * PERIOD_S * STEP_MARGIN + 1e-12).all()


GOOD = PAN
NAN = GOOD.positions_rad.copy()
NAN[50, 0] = np.nan
REFUSED = {
    "not a number": replace(GOOD, positions_rad=NAN),
    "unknown joint": replace(GOOD, joint_names=("knee",)),
    "no joint": replace(GOOD, joint_names=()),
    "joint twice": replace(move(shoulder_pan=(0.0, 1.0), elbow_flex=(0.0, 1.0)), joint_names=("elbow_flex",) * 2),
    "wrong shape": replace(GOOD, velocities_rad_s=GOOD.velocities_rad_s[:-1]),
    "time standing still": replace(GOOD, time_s=np.zeros_like(GOOD.time_s)),
    "endless time": replace(GOOD, time_s=np.append(GOOD.time_s[:-1], np.inf)),
    "time not from 0": replace(GOOD, time_s=GOOD.time_s + 1.0),
    "too fast": smooth_move({"shoulder_pan": (0.0, 1.0)}, duration_s=0.5),
    "beyond a limit": move(shoulder_pan=(0.0, 2.2)),
    "far from where the arm holds": move(shoulder_pan=(0.051, 1.0)),
    "far on the other side": move(shoulder_pan=(-0.051, 1.0)),
}


@pytest.mark.parametrize("trajectory", REFUSED.values(), ids=REFUSED.keys())
def test_a_trajectory_that_cannot_be_trusted_is_refused_and_nothing_moves(rig: Rig, trajectory: Trajectory) -> None:
    refused = rig.controller.execute(Execute(3, trajectory))
    assert refused.outcome is Outcome.REFUSED
    assert refused.message
    rig.tick()
    assert rig.controller.goal_rad == pytest.approx(np.zeros(6))


def test_a_motion_has_the_share_of_the_torque_limit_that_it_asks_for_above_0_to_1(rig: Rig) -> None:
    for share in (0.0, -0.5, 1.001, math.nan):
        refused = rig.controller.execute(Execute(1, PAN, torque_share=share))
        assert (refused.outcome, "torque_share" in refused.message) == (Outcome.REFUSED, True), share
    for share, way in ((0.001, PAN), (1.0, move(shoulder_pan=(1.0, 0.0)))):
        assert rig.controller.execute(Execute(1, way, torque_share=share)) is None
        assert rig.controller.torque_limit == pytest.approx([0.8 * share, 0.8, 0.8, 0.8, 0.8, 0.5])
        rig.until_end()
        assert rig.controller.torque_limit == pytest.approx([0.8] * 5 + [0.5])


def test_the_stop_of_one_motion_lets_another_go_on(rig: Rig) -> None:
    rig.controller.execute(Execute(2, move(gripper=(0.0, 0.5))))
    rig.move_pan(50)
    rig.controller.execute(Execute(3, move(wrist_flex=(0.0, 0.5), wrist_roll=(0.0, 0.5))))
    rig.controller.stop(1)
    rig.run(20)
    rig.controller.stop(3)
    ended, _ = rig.until_end()
    assert (ended.motion_id, ended.outcome) == (3, Outcome.STOPPED)
    assert [progress.motion_id for progress in rig.controller.progress] == [2]
    assert rig.until_end()[0] == MotionEnded(2, Outcome.REACHED, "the arm is there")


@pytest.mark.parametrize("away_rad", [0.049, -0.049])
def test_a_start_within_the_tolerance_is_reached_by_bounded_steps(rig: Rig, away_rad: float) -> None:
    assert rig.controller.execute(Execute(1, move(shoulder_pan=(away_rad, 1.0)))) is None
    rig.until_end()
    assert (rig.largest_step() <= BOUNDS.max_velocity * PERIOD_S * STEP_MARGIN + 1e-12).all()


def test_an_arm_found_outside_its_soft_limits_may_be_brought_back_inside_and_no_other_joint_moves() -> None:
    outside, others = float(BOUNDS.upper_rad[0]) + 0.1, [0.1, 0.2, 0.3, 0.4, 0.5]
    rig = Rig([outside, *others])
    assert rig.controller.execute(Execute(1, move(shoulder_pan=(outside, 1.0)))) is None
    assert rig.until_end()[0].outcome is Outcome.REACHED
    goals = np.array(rig.goals)
    assert goals[:, 0].max() <= outside
    assert goals[:, 1:] == pytest.approx(np.tile(others, (len(goals), 1)))


@pytest.mark.parametrize("way", ["motion", "stream", "stopped motion", "motion of two joints"])
def test_a_gripper_that_stalls_has_gripped_and_squeezes_a_little_at_less_torque_even_if_stopped(way: str) -> None:
    rig = Rig([0.0, 0.0, 0.0, 0.0, 0.0, 1.5])
    if way == "stream":
        rig.controller.stream(Stream(1, ("gripper",), gripping=True))
    else:
        others = {"wrist_roll": (0.0, 0.5)} if way == "motion of two joints" else {}
        rig.controller.execute(Execute(1, move(**others, gripper=(1.5, 0.0)), gripping=True, torque_share=0.8))
    object_rad, ended = 0.8, None
    for _ in range(600):
        rig.controller.steer(Setpoint(1, np.array([-0.8])))
        lag = np.zeros(6)
        lag[5] = max(0.0, object_rad - rig.controller.goal_rad[5])
        if way == "stopped motion" and lag[5] > 0.2:
            rig.controller.stop()
        ended = rig.tick(lag=lag, load=[0, 0, 0, 0, 0, -0.45 if lag[5] > 0.05 else 0.0]) or ended
    assert ended.outcome is (Outcome.STOPPED if way == "stopped motion" else Outcome.GRIPPED)
    assert way == "stopped motion" or ended.message == "joint gripper holds something at 0.800 rad"
    assert rig.controller.fault is None
    # 0.05 rad inside of the object, with half of the torque.
    assert rig.controller.goal_rad[5] == pytest.approx(object_rad - 0.05)
    assert rig.controller.torque_limit[5] == pytest.approx(0.25)


# As lerobot leaves them: half the gain, and a gripper whose overload protection begins at a quarter of its torque.
LEROBOT = Actuation(
    stiffness=np.full(6, 0.5),
    max_torque=np.array([1.0] * 5 + [0.5]),
    overload_torque=np.array([0.8] * 5 + [0.25]),
    overload_time_s=np.full(6, 2.0),
    overload_current_a=np.array([3.25] * 5 + [1.625]),
    stall_current_a=np.full(6, 2.7),
    free_speed_rad_s=np.full(6, 5.5),
    jump_rad=np.full(6, 0.46),
)


def test_a_joint_that_pushes_is_relieved_before_its_protection_latches_and_moves_next_with_its_full_torque() -> None:
    rig = Rig(actuation=LEROBOT)
    # Up to four fifths of its protection's threshold, for ever; above that for half of its protection's time.
    for load, ticks, limit in ((-0.199, 300, 0.5), (-0.201, 99, 0.5), (0.201, 3, 0.2)):
        rig.run(ticks, load=[0, 0, 0, 0, 0, load])
        assert rig.controller.torque_limit == pytest.approx([0.8] * 5 + [limit])
    rig.controller.execute(Execute(1, smooth_move({"gripper": (0.0, 0.5)}, duration_s=1.0)))
    assert rig.controller.torque_limit[5] == pytest.approx(0.5)


def test_a_soft_arm_that_droops_by_what_its_gain_explains_has_arrived() -> None:
    droop = np.array([0.0, -0.08, 0.0, 0.0, 0.0, 0.0])
    for actuation, outcome in ((None, Outcome.NOT_SETTLED), (LEROBOT, Outcome.REACHED)):
        rig = Rig(actuation=actuation)
        rig.controller.execute(Execute(1, move(shoulder_lift=(0.0, 0.5))))
        assert rig.until_end(lag=droop)[0].outcome is outcome


@pytest.mark.parametrize(("temperature_c", "slower"), [(59.9, 1.0), (60.0, 2.0), (64.0, 2.0)])
def test_a_hot_servo_slows_a_motion_and_a_stream_down(rig: Rig, temperature_c: float, slower: float) -> None:
    hot = [30.0, 30.0, temperature_c, 30.0, 30.0, 30.0]
    rig.controller.execute(Execute(1, PAN))
    ended, seconds = rig.until_end(temperature_c=hot)
    assert ended.outcome is Outcome.REACHED
    assert seconds == pytest.approx(2.0 * slower, abs=0.2)
    rig.controller.stream(Stream(7, ("elbow_flex",)))
    for _ in range(50):
        rig.controller.steer(Setpoint(7, np.array([-0.5])))
        rig.tick(temperature_c=hot)
    assert rig.controller.commanded[0].velocity_rad_s == pytest.approx([-0.5 / slower])


# Faults that relax the arm; those after which the goals stop at once; and those of a lost connection.
GRAVE = {FaultCode.OVERHEATED, FaultCode.OVERLOAD, FaultCode.OVERCURRENT}
FREEZING = {FaultCode.ENCODER_ERROR, FaultCode.POSITION_JUMP, FaultCode.EMERGENCY_STOP}
LOST = {FaultCode.BUS_LOST, FaultCode.SERVO_SILENT, FaultCode.BUS_SILENT}


@pytest.mark.parametrize("code", FaultCode)
def test_a_fault_ends_motions_with_its_outcome_brakes_or_freezes_and_only_a_graver_one_takes_its_place(
    rig: Rig, code: FaultCode
) -> None:
    rig.move_pan(100)
    at_fault_rad, measured = rig.controller.goal_rad[0], reading(rig.controller.goal_rad)
    (ended,) = rig.controller.react(Fault(code, "it was found"), measured)
    outcome = Outcome.TRACKING_LOST if code is FaultCode.TRACKING_LOST else Outcome.FAULT
    assert (ended.motion_id, ended.outcome) == (1, Outcome.BUS_LOST if code in LOST else outcome)
    assert "it was found" in ended.message
    assert rig.controller.moving is (code not in FREEZING)
    rig.run(100)
    moved_rad = rig.controller.goal_rad[0] - at_fault_rad
    assert moved_rad == pytest.approx(0.0) if code in FREEZING else 0.0 < moved_rad < 0.3
    accelerations = np.abs(np.diff(np.array(rig.goals)[:, 0], n=2)) / PERIOD_S**2 / BOUNDS.max_acceleration[0]
    assert bool(accelerations.max() <= 1.05) is (code not in FREEZING)
    assert not rig.controller.moving
    for later in FaultCode:
        rig.controller.fault = Fault(code, "it was found")
        rig.controller.react(Fault(later, "it came then"), measured)
        assert rig.controller.fault.code is (later if later in GRAVE and code not in GRAVE else code), later


POSITIONS = st.lists(st.floats(min_value=-2.0, max_value=2.0), min_size=6, max_size=6)


@given(
    start=POSITIONS,
    ends=st.lists(st.floats(min_value=-1.0, max_value=1.0), min_size=3, max_size=3),
    gaps=st.lists(st.sampled_from([-0.01, 0.0, 0.005, 0.01, 0.013, 0.05, 1.0]), min_size=40, max_size=40),
    errors=st.lists(st.floats(min_value=-0.6, max_value=0.6), min_size=40, max_size=40),
)
def test_whatever_happens_goals_move_by_bounded_steps_inside_the_limits(
    start: list[float], ends: list[float], gaps: list[float], errors: list[float]
) -> None:
    inside = np.clip(start, BOUNDS.lower_rad, BOUNDS.upper_rad)
    rig = Rig(inside.tolist())
    for tick, (gap_s, error) in enumerate(zip(gaps, errors, strict=True)):
        if tick % 13 == 0:
            goal = float(np.clip(inside[0] + ends[tick // 13 % 3], BOUNDS.lower_rad[0], BOUNDS.upper_rad[0]))
            rig.controller.execute(Execute(tick, move(shoulder_pan=(float(rig.controller.goal_rad[0]), goal))))
        if tick % 17 == 16:
            rig.controller.stop()
        rig.tick(lag=np.array([error, 0, 0, 0, 0, -error]), gap_s=gap_s, load=0.9)
        step = np.abs(rig.goals[-1] - rig.goals[-2])
        assert (step <= BOUNDS.max_velocity * min(max(gap_s, 0.0), 0.02) * STEP_MARGIN + 1e-9).all()
        assert (rig.goals[-1] >= BOUNDS.lower_rad - 1e-9).all()
        assert (rig.goals[-1] <= BOUNDS.upper_rad + 1e-9).all()


def test_a_paused_motion_waits_and_goes_back_and_on_as_it_is_reported(rig: Rig) -> None:
    rig.controller.execute(Execute(1, PAN))
    for _ in range(100):
        assert rig.tick() is None
    rig.controller.change_pace(ChangePace(direction=PlaybackDirection.PAUSED))
    for _ in range(200):
        assert rig.tick() is None
    paused_at = rig.goals[-1][0]
    assert rig.goals[-50][0] == paused_at
    assert rig.controller.mode is Mode.MOVING
    rig.controller.change_pace(ChangePace(direction=PlaybackDirection.BACK))
    rig.run(30)
    assert rig.goals[-1][0] < paused_at
    rig.controller.change_pace(ChangePace(direction=PlaybackDirection.FORWARD))
    assert rig.until_end()[0].outcome is Outcome.REACHED
    assert (rig.largest_step() <= BOUNDS.max_velocity * PERIOD_S * STEP_MARGIN + 1e-9).all()


def test_a_speed_factor_holds_for_motions_to_come_and_a_pause_ends_with_its_motion(rig: Rig) -> None:
    rig.controller.change_pace(ChangePace(speed_factor=0.5, direction=PlaybackDirection.PAUSED))
    rig.controller.execute(Execute(1, PAN))
    ended, seconds = rig.until_end()
    assert ended.outcome is Outcome.REACHED
    assert seconds == pytest.approx(4.0, abs=0.1)
    assert rig.controller.pace == Pace(0.5, PlaybackDirection.FORWARD)


def test_a_pause_does_not_keep_the_gripper_from_gripping(rig: Rig) -> None:
    rig.move_pan(50)
    rig.controller.change_pace(ChangePace(direction=PlaybackDirection.PAUSED))
    rig.controller.execute(Execute(2, move(gripper=(0.0, 0.5)), gripping=True))
    ended, seconds = rig.until_end()
    assert (ended.motion_id, ended.outcome) == (2, Outcome.REACHED)
    assert seconds == pytest.approx(2.0, abs=0.1)
    assert rig.controller.pace.direction is PlaybackDirection.PAUSED


def test_a_speed_factor_from_0_to_1_and_a_limit_from_0_01_to_1_are_taken_and_others_change_nothing(rig: Rig) -> None:
    factors = (ChangePace(speed_factor=each) for each in (-0.001, 1.001, math.nan))
    limits = (ChangePace(speed_limit=each) for each in (0.0, 0.0099, 1.001, -1.0, math.nan))
    for change in (*factors, *limits):
        rig.controller.change_pace(change)
        assert rig.controller.pace == Pace(), change
    for factor, limit in ((0.0, 0.01), (1.0, 1.0)):
        rig.controller.change_pace(ChangePace(speed_factor=factor, speed_limit=limit))
        assert rig.controller.pace == Pace(factor, speed_limit=limit)


def test_a_setpoint_after_its_stream_has_ended_moves_nothing(rig: Rig) -> None:
    rig.controller.stream(Stream(7, ("shoulder_pan",)))
    for tick in range(140):
        if tick == 20:
            rig.controller.stop()
        if tick == 120:
            held = rig.controller.goal_rad
            assert rig.controller.mode is Mode.HOLDING
        rig.controller.steer(Setpoint(7, np.array([0.5])))
        rig.tick()
    assert rig.controller.goal_rad == pytest.approx(held)


def test_a_stream_and_a_motion_of_one_joint_exclude_each_other_and_joints_that_are_none_are_refused(rig: Rig) -> None:
    rig.controller.stream(Stream(7, ("shoulder_pan",)))
    assert "motion 7 of joint shoulder_pan" in rig.controller.execute(Execute(8, PAN)).message
    assert rig.controller.execute(Execute(9, move(gripper=(0.0, 0.5)), gripping=True)) is None
    assert rig.controller.stream(Stream(10, ("shoulder_pan", "elbow_flex"))).outcome is Outcome.REFUSED
    for names in ((), ("knee",), ("shoulder_pan", "shoulder_pan")):
        assert Rig().controller.stream(Stream(7, names)).outcome is Outcome.REFUSED, names


def test_a_motion_takes_the_place_of_another_without_a_stop(rig: Rig) -> None:
    rig.move_pan(100, 7)
    ended = rig.controller.execute(Execute(8, PAN, continues=Continuation(7, 0.0)))
    assert (ended.motion_id, ended.outcome) == (7, Outcome.STOPPED)
    before = rig.goals[-1] - rig.goals[-2]
    rig.tick()
    np.testing.assert_allclose(rig.goals[-1] - rig.goals[-2], before, atol=1e-4)
    ended, _ = rig.until_end()
    assert (ended.motion_id, ended.outcome) == (8, Outcome.REACHED)


LIMIT = 0.1

# The rate of a motion is chosen so that no joint exceeds the limit; what is left is rounding.
ROUNDING = 1.0 + 1e-6


def limited(*, gripping: bool = False, **joints: tuple[float, float]) -> Rig:
    rig = Rig()
    rig.controller.change_pace(ChangePace(speed_limit=LIMIT))
    rig.controller.execute(Execute(1, move(**joints), gripping=gripping))
    return rig


def test_no_joint_of_a_motion_is_faster_than_the_speed_limit_and_a_slow_one_is_played_as_planned() -> None:
    pan, grip = limited(shoulder_pan=(0.0, 1.0), wrist_roll=(0.0, -1.0)), limited(gripping=True, gripper=(0.0, 1.0))
    for rig in (pan, grip):
        assert rig.until_end()[0].outcome is Outcome.REACHED
        assert (rig.largest_step() <= LIMIT * BOUNDS.max_velocity * PERIOD_S * ROUNDING).all()
    assert pan.controller.goal_rad[0] == pytest.approx(1.0)
    _, seconds = limited(shoulder_pan=(0.0, 0.05)).until_end()
    assert seconds == pytest.approx(2.0, abs=0.1)


def test_a_speed_limit_that_is_lowered_slows_the_motion_in_progress(rig: Rig) -> None:
    rig.move_pan(100)
    rig.controller.change_pace(ChangePace(speed_limit=LIMIT))
    rig.run(50)
    rig.goals = rig.goals[-2:]
    rig.until_end()
    assert rig.largest_step()[0] <= LIMIT * BOUNDS.max_velocity[0] * PERIOD_S * ROUNDING


@pytest.mark.parametrize("lowered_at", [0, 30])
def test_no_joint_of_a_stream_is_faster_than_the_speed_limit_also_when_it_is_lowered(rig: Rig, lowered_at: int) -> None:
    if not lowered_at:
        rig.controller.change_pace(ChangePace(speed_limit=LIMIT))
    rig.controller.stream(Stream(1, ("shoulder_pan", "wrist_roll")))
    for tick in range(120):
        if tick == lowered_at:
            rig.controller.change_pace(ChangePace(speed_limit=LIMIT))
        if tick == 60:
            rig.goals = rig.goals[-1 if lowered_at else 0 :]
        rig.controller.steer(Setpoint(1, np.array([1.5, -1.0])))
        rig.tick()
    pan, roll = (rig.largest_step()[joint] / BOUNDS.max_velocity[joint] / PERIOD_S for joint in (0, 4))
    assert 0.98 * LIMIT < max(pan, roll) <= LIMIT * ROUNDING
    assert rig.largest_step()[4] / rig.largest_step()[0] == pytest.approx(1.0 / 1.5, rel=0.05)
