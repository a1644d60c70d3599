from __future__ import annotations

from collections.abc import Callable

import pytest

from robot.advice import ServoAlert
from robot.calibration import MAX_TICK
from robot.errors import StartupError
from robot.faults import FaultCode
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.profiles import LEROBOT, ServoProfile
from robot.hardware.feetech.registers import Control, Register
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.feetech.settings import SETTINGS_BYTES, ServoSettings, parse_settings
from robot.hardware.feetech.survey import (
    CYCLES_BETWEEN,
    PHASE_MULTI_TURN,
    RegisterChecks,
    ServoFound,
    calibration_refusal,
    survey,
)
from robot.hardware.feetech.torque import full_torque
from tests.helpers.arm_rig import BOUNDS, CALIBRATION, run
from tests.helpers.emulator import SteppedEmulator

SERVOS = ServoMap(CALIBRATION, BOUNDS)

Start = Callable[..., SteppedEmulator]


def test_a_survey_reports_commands_and_limits_of_every_servo(bus: Bus) -> None:
    found = run(survey(bus, SERVOS))
    assert set(found) == set(SERVOS.ids)
    for joint in CALIBRATION.joints:
        servo = found[joint.servo_id]
        assert not servo.control.torque_on
        assert servo.settings.angle_limits_ticks == (joint.range_min, joint.range_max)
        assert servo.warnings == ()


@pytest.mark.parametrize("offline", [[3], list(SERVOS.ids)])
def test_errors_of_emulated_servos_name_no_cables_and_supply(
    emulator: SteppedEmulator, bus: Bus, offline: list[int]
) -> None:
    emulator.command(offline=offline)
    with pytest.raises(StartupError, match=r"^no (servo answers|answer from elbow_flex \(id 3\))$"):
        run(survey(bus, SERVOS, simulated=True))


def test_a_servo_in_another_operating_mode_is_refused(bus: Bus) -> None:
    bus.write(2, Register.OPERATING_MODE, 1)
    with pytest.raises(StartupError, match=r"servo 2 \(shoulder_lift\) is in operating mode 1"):
        run(survey(bus, SERVOS))


def set_all(bus: Bus, profile: ServoProfile) -> None:
    for joint in CALIBRATION.joints:
        for register, value in profile.expected(gripper=joint.servo.gripper).items():
            bus.write(joint.servo_id, register, value)


def test_servos_as_lerobot_leaves_them_are_well(bus: Bus) -> None:
    set_all(bus, LEROBOT)
    assert {servo: found.warnings for servo, found in run(survey(bus, SERVOS)).items()} == dict.fromkeys(SERVOS.ids, ())


def test_a_setting_that_differs_from_its_profile_is_told_with_its_consequence(bus: Bus) -> None:
    set_all(bus, LEROBOT)
    bus.write(3, Register.PROTECTION_TIME, 20)
    found = run(survey(bus, SERVOS))
    assert [servo for servo in SERVOS.ids if found[servo].warnings] == [3]
    (warning,) = found[3].warnings
    assert warning.sentence == (
        "register PROTECTION_TIME is 20, not 200 as in the profile lerobot: an overload latches after 0.2 s"
    )


def test_servos_are_compared_with_the_profile_of_the_arm_if_it_has_one(bus: Bus) -> None:
    found = run(survey(bus, SERVOS, LEROBOT))
    said = {servo: [warning.sentence for warning in found[servo].warnings] for servo in SERVOS.ids}
    assert all("P_GAIN is 32, not 16" in " ".join(sentences) for sentences in said.values())
    assert all(found[servo].expected[Register.P_GAIN] == 16 for servo in SERVOS.ids)


@pytest.mark.parametrize(
    ("register", "value", "alert", "words"),
    [
        (Register.MIN_ANGLE_LIMIT, 100, ServoAlert.ANGLE_LIMITS, "(100, "),
        (Register.PHASE, 12 | PHASE_MULTI_TURN, ServoAlert.SEVERAL_TURNS, "its position may overflow"),
        (Register.RETURN_DELAY, 250, ServoAlert.RETURN_DELAY, "500 us later: set register RETURN_DELAY to 0"),
        (Register.LOCK, 0, ServoAlert.EPROM_UNLOCKED, "EPROM is unlocked"),
        (Register.P_GAIN, 8, ServoAlert.REGISTER, "droops further"),
        (Register.MAX_TORQUE, 300, ServoAlert.REGISTER, "30 % of its torque"),
    ],
)
def test_a_deviating_setting_is_a_warning(
    bus: Bus, register: Register, value: int, alert: ServoAlert, words: str
) -> None:
    bus.write(2, register, value)
    (warning,) = run(survey(bus, SERVOS))[2].warnings
    assert warning.alert is alert
    assert words in warning.sentence


def test_an_arm_is_surveyed_in_few_transactions(bus: Bus) -> None:
    before = bus.counters.sent
    run(survey(bus, SERVOS))
    # A ping and the model, the settings, and the commands.
    assert bus.counters.sent - before == 4 * len(SERVOS.ids)


def test_a_homing_offset_that_is_the_calibrations_refuses_nothing(bus: Bus) -> None:
    assert calibration_refusal(SERVOS, run(survey(bus, SERVOS))) == ""


def test_a_homing_offset_that_another_program_wrote_is_refused_with_both_remedies(bus: Bus) -> None:
    bus.write(3, Register.HOMING_OFFSET, -85)
    reason = calibration_refusal(SERVOS, run(survey(bus, SERVOS)))
    assert "elbow_flex (id 3) by 7.5 deg (-85 instead of 0 ticks)" in reason
    assert "calibrate the arm anew" in reason
    assert "--write-back" in reason


@pytest.mark.parametrize("by_ticks", [-60, 60])
def test_the_limits_of_another_zero_at_the_calibrated_offset_are_refused(bus: Bus, by_ticks: int) -> None:
    joint = CALIBRATION.joints[2]
    bus.write(3, Register.MIN_ANGLE_LIMIT, joint.range_min + by_ticks)
    bus.write(3, Register.MAX_ANGLE_LIMIT, joint.range_max + by_ticks)
    reason = calibration_refusal(SERVOS, run(survey(bus, SERVOS)))
    assert f"elbow_flex (id 3) {joint.range_min + by_ticks} to {joint.range_max + by_ticks} instead of" in reason
    assert "--write-back" in reason


@pytest.mark.parametrize(("low", "high"), [(0, MAX_TICK), (60, MAX_TICK), (0, -60), (60, -60), (60, 0)])
def test_limits_that_were_opened_or_narrowed_refuse_nothing(bus: Bus, low: int, high: int) -> None:
    joint = CALIBRATION.joints[2]
    bus.write(3, Register.MIN_ANGLE_LIMIT, low and joint.range_min + low)
    bus.write(3, Register.MAX_ANGLE_LIMIT, high if high == MAX_TICK else joint.range_max + high)
    assert calibration_refusal(SERVOS, run(survey(bus, SERVOS))) == ""


def test_lost_replies_do_not_hinder_a_survey(start_emulator: Start) -> None:
    bus = start_emulator("--drop", "0.03", "--corrupt", "0.03", "--seed", "3").open_bus()
    assert len(run(survey(bus, SERVOS))) == len(SERVOS.ids)
    assert bus.counters.timeouts > 0
    bus.close()


WELL = Control(True, 254, 2048, 800)


@pytest.fixture
def checks() -> RegisterChecks:
    settings = parse_settings(bytes(SETTINGS_BYTES)).values | {Register.MAX_TORQUE: 1000}
    found = ServoFound(777, WELL, ServoSettings(settings))
    made = RegisterChecks(SERVOS, dict.fromkeys(SERVOS.ids, found))
    made.expect(full_torque(SERVOS))
    return made


def test_every_servo_has_its_turn_within_a_second(checks: RegisterChecks) -> None:
    turns = [servo for _ in range(100) if (servo := checks.due()) is not None]
    assert set(turns) == set(SERVOS.ids)
    assert len(turns) == 100 // CYCLES_BETWEEN


def test_a_servo_that_holds_what_was_written_is_no_fault(checks: RegisterChecks) -> None:
    assert checks.check(1, WELL, 0.0) is None
    assert checks.torque_on[1]


@pytest.mark.parametrize(
    ("control", "code"),
    [
        (Control(False, 254, 2048, 800), FaultCode.TORQUE_LOST),
        (Control(False, 0, 0, 1000), FaultCode.SERVO_REBOOTED),
        (Control(True, 254, 2048, 1000), FaultCode.SERVO_REBOOTED),
    ],
    ids=["relaxed", "rebooted relaxed", "rebooted driven"],
)
def test_a_servo_that_holds_other_values_is_a_fault(checks: RegisterChecks, control: Control, code: FaultCode) -> None:
    fault = checks.check(2, control, 5.0)
    assert (fault.code, fault.joint, fault.stamp_s) == (code, "shoulder_lift", 5.0)


def test_torque_limits_are_written_once_and_again_when_they_were_lost(checks: RegisterChecks) -> None:
    wanted = {**full_torque(SERVOS), 6: 250}
    assert checks.limits_to_write(wanted) == {6: 250}
    assert checks.limits_to_write(wanted) == {}
    assert checks.check(6, Control(True, 254, 2048, 500), 0.0) is None
    assert checks.limits_to_write(wanted) == {6: 250}
