import itertools
from typing import Any

import numpy as np
import pytest

from robot.control.guards import ActuatorThresholds
from robot.faults import Fault, FaultCode, ServoAlert, ServoWarning
from robot.hardware.interface import Actuation, Measured, StatusFlag
from robot.messages import GuardLimits
from tests.helpers.arm_rig import PLAIN, guards, reading

GOAL = np.zeros(6)
FULL = np.array([0.8] * 5 + [0.5])
JUMP_RAD = float(PLAIN.jump_rad[0])
PERIOD_S = 0.01
LIMITS = GuardLimits()
FLAGGED = int(StatusFlag.VOLTAGE)


def at(joint: int, value: float, else_value: float = 0.0) -> list[float]:
    return [value if each == joint else else_value for each in range(6)]


def seconds_until(code: FaultCode, position: Any = GOAL, limits: GuardLimits = LIMITS, **readings: Any) -> float:
    """Time for which the guards tolerate a reading before this fault [s]."""
    checked = guards(limits, np.full(6, 8.0))
    for tick in range(round(3.0 / PERIOD_S)):
        fault = checked.check(GOAL, reading(position, **readings), FULL, tick * PERIOD_S)
        if fault is not None:
            assert fault.code is code
            return tick * PERIOD_S
    raise AssertionError(f"no {code}")


def never(position: Any = GOAL, limits: GuardLimits = LIMITS, **readings: Any) -> bool:
    checked = guards(limits)
    return all(checked.check(GOAL, reading(position, **readings), FULL, tick * PERIOD_S) is None for tick in range(300))


# Conditions of the elbow, the gravest first.
BY_GRAVITY = {
    FaultCode.OVERHEATED: ("status", int(StatusFlag.TEMPERATURE), 0.0),
    FaultCode.OVERLOAD: ("status", int(StatusFlag.OVERLOAD), 0.0),
    FaultCode.OVERCURRENT: ("status", int(StatusFlag.CURRENT), 0.0),
    FaultCode.ENCODER_ERROR: ("status", int(StatusFlag.ENCODER), 0.0),
    FaultCode.SERVO_SILENT: ("age_s", 0.101, 0.0),
    FaultCode.VOLTAGE_LOW: ("voltage_v", 4.4, 6.0),
    FaultCode.STALLED: ("load", 0.7, 0.0),
}


@pytest.mark.parametrize("code", BY_GRAVITY)
def test_of_several_conditions_the_gravest_is_the_fault_and_names_the_joint(code: FaultCode) -> None:
    told: dict[str, Any] = {}
    for name, value, else_value in list(BY_GRAVITY.values())[list(BY_GRAVITY).index(code) :]:
        told[name] = np.add(told.get(name, 0), at(2, value, else_value)).astype(int if name == "status" else float)
    checked, measured = guards(), reading(at(2, 0.4), **told)
    faults = [checked.check(GOAL, measured, FULL, now_s) for now_s in (0.0, 0.5)]
    assert (faults[1].code, faults[1].joint) == (code, "elbow_flex")
    assert "elbow_flex" in faults[1].message
    assert faults[1].remedy
    # Those ahead of the supply do not have to last.
    assert (faults[0] is not None) == (list(BY_GRAVITY).index(code) < 5)


def test_of_several_joints_the_farthest_from_its_goal_is_named_among_those_with_the_fault() -> None:
    hot = [30.0, 65.0, 65.0, 65.0, 30.0, 30.0]
    fault = guards().check(GOAL, reading([0.0, 0.1, -0.2, 0.1, 0.0, 0.3], temperature_c=hot), FULL, 0.0)
    assert (fault.code, fault.message) == (FaultCode.OVERHEATED, "joint elbow_flex is at 65 degC")
    assert never(temperature_c=64.9, age_s=0.1, voltage_v=4.5)
    checked = guards()
    faults = [checked.check(GOAL, reading(GOAL, temperature_c=each), FULL, 1.0) for each in (64.9, 65.0)]
    assert [fault is None for fault in faults] == [True, False]


BEARABLE = {
    "far behind": (FaultCode.TRACKING_LOST, at(1, 0.4), {}, LIMITS.tracking_time_s),
    "much current": (FaultCode.STALLED, at(1, 0.2), {"current_a": at(1, -2.0)}, LIMITS.stall_time_s),
    "low supply, as a motor starts": (FaultCode.VOLTAGE_LOW, GOAL, {"voltage_v": 4.4}, 0.2),
    "supply flag, too high": (FaultCode.VOLTAGE_HIGH, GOAL, {"voltage_v": 12.0, "status": FLAGGED}, 2.0),
    "supply flag, too low": (FaultCode.VOLTAGE_LOW, GOAL, {"voltage_v": 5.0, "status": FLAGGED}, 2.0),
}


@pytest.mark.parametrize(("code", "position", "readings", "bearable_s"), BEARABLE.values(), ids=BEARABLE.keys())
def test_some_readings_are_a_fault_when_they_last(
    code: FaultCode, position: Any, readings: dict[str, Any], bearable_s: float
) -> None:
    assert seconds_until(code, position, **readings) == pytest.approx(bearable_s)


def test_a_joint_is_stalled_that_is_5_deg_behind_pushes_with_much_load_or_current_and_all_but_stands() -> None:
    # Of its full torque of 0.8, the joint uses 80 %; 0.046 rad/s are 3 deg/s.
    near = (0.0915, -0.0915, 0.0925, -0.0925), (0.0, 0.63, -0.65), (0.0, 1.49, -1.51), (0.045, -0.045, 0.047, -0.047)
    for behind_rad, load, current_a, speed_rad_s in itertools.product(*near):
        told = {"load": at(1, load), "current_a": at(1, current_a), "velocity_rad_s": at(1, speed_rad_s)}
        checked, measured = guards(), reading(at(1, behind_rad), **told)
        faults = [checked.check(GOAL, measured, FULL, now_s) for now_s in (0.0, 0.29, 0.31)]
        stalls = abs(behind_rad) > 0.092 and (load == -0.65 or current_a == -1.51) and abs(speed_rad_s) < 0.046
        assert [fault is not None for fault in faults] == [False, False, stalls], (behind_rad, told)
        assert checked.stalled == [joint == 1 and stalls for joint in range(6)], (behind_rad, told)


def test_a_yielding_joint_may_stall_and_is_flagged() -> None:
    checked, yielding = guards(), np.array(at(5, 1)) > 0
    for tick in range(50):
        measured = reading(at(5, 0.2), load=at(5, 0.5))
        assert checked.check(GOAL, measured, FULL, tick * PERIOD_S, yielding) is None
    assert checked.stalled == yielding.tolist()


def test_every_threshold_can_be_set() -> None:
    patient = GuardLimits(tracking_error_rad=0.5, tracking_time_s=0.4, stall_current_a=2.5, stall_time_s=0.6)
    assert never(at(1, 0.4), patient)
    assert seconds_until(FaultCode.TRACKING_LOST, at(1, 0.6), patient) == pytest.approx(0.4)
    assert never(at(1, 0.2), patient, current_a=at(1, -2.0))
    assert seconds_until(FaultCode.STALLED, at(1, 0.2), patient, current_a=at(1, -2.6)) == pytest.approx(0.6)
    strict = GuardLimits(tracking_error_rad=0.05, silent_after_s=0.05)
    late = at(2, 0.06)
    assert never(GOAL, age_s=late)
    assert seconds_until(FaultCode.SERVO_SILENT, GOAL, strict, age_s=late) == 0.0
    assert never(GOAL, GuardLimits(silent_after_s=1.0), age_s=at(2, 0.9))
    assert seconds_until(FaultCode.TRACKING_LOST, at(1, 0.06), strict) == pytest.approx(LIMITS.tracking_time_s)


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize(
    ("further_rad", "gap_s", "age_s", "age_before_s", "jumps"),
    [
        (0.06, PERIOD_S, 0.0, 0.0, True),
        (0.05, PERIOD_S, 0.0, 0.0, False),
        (0.09, 0.1, 0.0, 0.0, False),
        # The time between two readings counts, not between the ticks that take them.
        (0.06, 0.1, 0.09, 0.0, True),
        (0.05, 0.1, 0.09, 0.0, False),
        (0.09, PERIOD_S, 0.0, 0.09, False),
        (0.5, PERIOD_S, 0.0, 0.09, False),
        (0.6, PERIOD_S, 0.0, 0.09, True),
    ],
)
def test_a_joint_that_cannot_have_turned_so_far_has_jumped(
    way: float, further_rad: float, gap_s: float, age_s: float, age_before_s: float, jumps: bool
) -> None:
    # 5.5 rad/s are the free speed.
    checked, position = guards(), at(0, way * (JUMP_RAD + further_rad))
    checked.check(GOAL, reading(GOAL, age_s=age_before_s), FULL, 1.0)
    fault = checked.check(GOAL, reading(position, age_s=age_s), FULL, 1.0 + gap_s)
    assert (fault is not None and fault.code is FaultCode.POSITION_JUMP) is jumps


def found_in_silence(age_s: list[float], measured: Measured | None = None) -> Fault | None:
    """The fault of an arm that was well whose joints then have readings of these ages."""
    checked = guards()
    assert checked.check(GOAL, reading(GOAL), FULL, 1.0) is None
    measured = (measured or reading(GOAL))._replace(age_s=np.array(age_s))
    return checked.check(GOAL, measured, FULL, 1.1)


@pytest.mark.parametrize("position", [GOAL, at(1, 0.2)])
@pytest.mark.parametrize(
    ("age_s", "code", "joint", "silent_s"),
    [
        ([0.31, 0.31, 0.11, 0.31, 0.31, 0.31], FaultCode.BUS_SILENT, "", "0.11"),
        # Three cycles without any answer.
        ([0.031, 0.031, 0.031, 0.031, 0.12, 0.031], FaultCode.BUS_SILENT, "", "0.03"),
        ([0.031, 0.031, 0.031, 0.029, 0.12, 0.031], FaultCode.SERVO_SILENT, "wrist_roll", "0.12"),
        ([0.0, 0.0, 0.0, 0.0, 0.12, 0.0], FaultCode.SERVO_SILENT, "wrist_roll", "0.12"),
        ([0.12, 0.12, 0.12, 0.0, 0.12, 0.12], FaultCode.SERVO_SILENT, None, "0.12"),
    ],
)
def test_all_joints_silent_at_once_are_a_silent_bus_and_fewer_are_silent_servos(
    position: Any, age_s: list[float], code: FaultCode, joint: str | None, silent_s: str
) -> None:
    fault = found_in_silence(age_s, reading(position))
    assert fault.code is code
    assert joint in (None, fault.joint)
    assert f"for {silent_s} s" in fault.message


def test_an_arm_that_measures_neither_heat_nor_current_nor_supply_is_well_and_so_is_one_beyond_its_angle() -> None:
    unmeasured = float("nan")
    assert never(temperature_c=unmeasured, current_a=unmeasured, voltage_v=unmeasured, status=int(StatusFlag.ANGLE))
    assert never(at(1, 0.2), temperature_c=unmeasured, current_a=unmeasured, voltage_v=unmeasured)


@pytest.mark.parametrize(
    ("ill", "bearable_s"),
    [
        (reading(GOAL, voltage_v=4.4), 0.2),
        (reading(at(1, 0.2), load=at(1, 0.7)), LIMITS.stall_time_s),
        (reading(at(1, 0.4)), LIMITS.tracking_time_s),
    ],
)
def test_one_tick_in_which_all_is_well_makes_a_condition_begin_anew(ill: Measured, bearable_s: float) -> None:
    checked, ticks = guards(), round(bearable_s / PERIOD_S)
    readings = 2 * [*(ticks - 1) * [ill], reading(GOAL)]
    faults = [checked.check(GOAL, each, FULL, tick * PERIOD_S) for tick, each in enumerate(readings)]
    assert faults == [None] * len(readings)


@pytest.mark.parametrize(
    ("told", "warnings"),
    [
        ({"temperature_c": 54.9, "age_s": 0.1}, []),
        ({"temperature_c": 55.0}, [(ServoAlert.WARM, "warm: 55 degC")]),
        ({"temperature_c": 59.4}, [(ServoAlert.WARM, "warm: 59 degC")]),
        ({"temperature_c": 60.0}, [(ServoAlert.SLOWED, "motions run at half speed at 60 degC")]),
        ({"temperature_c": 64.0}, [(ServoAlert.SLOWED, "motions run at half speed at 64 degC")]),
        ({"age_s": 0.5}, [(ServoAlert.NO_ANSWER, "no answer for 0.5 s")]),
        (
            {"status": int(StatusFlag.OVERLOAD | StatusFlag.VOLTAGE)},
            [
                (ServoAlert.VOLTAGE, "the servo complains of voltage"),
                (ServoAlert.OVERLOAD, "the servo complains of overload"),
            ],
        ),
    ],
)
def test_warnings_come_before_faults(told: dict[str, float], warnings: list[tuple[ServoAlert, str]]) -> None:
    assert guards().warnings(reading(GOAL, **told), 0) == tuple(ServoWarning(*warning) for warning in warnings)


FULL_OF_TWO = np.array([0.8, 0.5])


def assumed(**settings: float) -> ActuatorThresholds:
    """Thresholds for two equal actuators, which are as the factory's but for the named settings."""
    usual = {
        "stiffness": 1.0,
        "max_torque": 1.0,
        "overload_torque": 0.8,
        "overload_time_s": 2.0,
        "overload_current_a": 3.25,
        "stall_current_a": 2.7,
        "free_speed_rad_s": 5.5,
        "jump_rad": 0.46,
    }
    return ActuatorThresholds.of(
        LIMITS, Actuation(**{name: np.full(2, value) for name, value in (usual | settings).items()}), FULL_OF_TWO
    )


def test_servos_of_the_factory_and_actuators_without_protection_are_taken_as_the_limits_say() -> None:
    unprotected = Actuation.unprotected(np.full(2, 5.5), np.full(2, 0.46))
    for made in (assumed(), ActuatorThresholds.of(LIMITS, unprotected, FULL_OF_TWO)):
        assert made.goal_tolerance_rad == pytest.approx(LIMITS.goal_tolerance_rad)
        assert made.sustained_torque == pytest.approx(FULL_OF_TWO)
        assert np.isinf(made.relieve_after_s).all()
        assert made.stall_current_a == pytest.approx(LIMITS.stall_current_a)
        assert made.stall_time_s == pytest.approx(LIMITS.stall_time_s)


def test_a_joint_with_half_the_gain_may_droop_twice_as_far_and_none_less_than_the_limit_or_boundlessly() -> None:
    least_rad = LIMITS.goal_tolerance_rad
    assert assumed(stiffness=0.5).goal_tolerance_rad == pytest.approx((1.0 + 2.0 * 2.0) / 3.0 * least_rad)
    for stiffness in (0.0, 0.01, 0.2, 2.0, 8.0):
        tolerance = assumed(stiffness=stiffness).goal_tolerance_rad
        assert (tolerance >= least_rad - 1e-9).all(), stiffness
        assert (tolerance <= 0.3).all(), stiffness
    assert assumed(stiffness=0.01).goal_tolerance_rad == pytest.approx(0.3)


def test_a_joint_holds_with_less_torque_and_current_than_its_protection_permits() -> None:
    made = assumed(overload_torque=0.25)
    # Four fifths of the threshold, after half of the protection's time.
    assert made.sustained_torque == pytest.approx(0.2)
    assert made.relieve_after_s == pytest.approx(1.0)
    made = assumed(overload_current_a=0.27)
    assert made.sustained_torque == pytest.approx(0.08)
    assert made.stall_current_a == pytest.approx(0.216)
    # Stalls are reported sooner where the servo's own protection acts quickly.
    made = assumed(overload_time_s=0.4, overload_torque=0.25)
    assert made.stall_time_s == pytest.approx(0.1)
    assert (made.stall_time_s < made.relieve_after_s).all()
    assert (made.relieve_after_s < 0.4).all()


@pytest.mark.parametrize("seed", range(20))
def test_the_short_way_through_the_guards_finds_what_the_long_one_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    short, long = guards(), guards()
    long._sound = lambda *_: False  # type: ignore[method-assign]
    near, low, silent = LIMITS.tracking_error_rad, LIMITS.min_voltage_v, LIMITS.silent_after_s
    hot = LIMITS.stop_temperature_c
    taken = 0
    for tick in range(400):
        # At rest at first, then sometimes beyond one of the limits for a while.
        if tick % 80 == 0:
            beyond = (rng.random(5) < 0.2) & (tick > 0)
            offset = rng.choice([0.0, 0.14, 2.0 * near]) * rng.random(6) * (tick > 0)
            load, ill = rng.uniform(0.0, 1.0), rng.random(6) < 0.4
            volts, flags = rng.uniform(low - 0.5, low + 0.5), rng.choice([FLAGGED, int(StatusFlag.OVERLOAD)])
        position = offset + rng.normal(0.0, 0.002, 6)
        measured = reading(
            position,
            temperature_c=np.where(ill & beyond[1], rng.uniform(hot - 3.0, hot + 0.5), 40.0),
            voltage_v=np.where(ill & beyond[2], volts, 6.0),
            status=np.where(ill & beyond[3], flags, 0),
            age_s=rng.uniform(0.0, 1.2 * silent, 6) if beyond[4] else 0.0,
            load=load,
        )
        found = [each.check(GOAL, measured, FULL, tick * PERIOD_S) for each in (short, long)]
        assert found[0] == found[1]
        assert (list(short.stalled), list(short.lost)) == (list(long.stalled), list(long.lost))
        taken += short._idle
    assert 0 < taken < 400
