from __future__ import annotations

import pytest

from robot.advice import ServoAlert
from robot.errors import NoReply, StartupError
from robot.faults import FaultCode
from robot.hardware.dynamixel.registers import OperatingMode, Register, encode
from robot.hardware.dynamixel.servo_map import ServoMap
from robot.hardware.dynamixel.survey import (
    CYCLES_BETWEEN,
    WATCHDOG,
    RegisterChecks,
    ServoFound,
    limits_of,
    refusal,
    survey,
)
from robot.hardware.interface import run_to_end
from tests.helpers.dynamixel import BOUNDS, CALIBRATION, SteppedDynamixels

SERVOS = ServoMap(CALIBRATION, BOUNDS)


@pytest.fixture
def dynamixels() -> SteppedDynamixels:
    return SteppedDynamixels()


def surveyed(dynamixels: SteppedDynamixels, *, simulated: bool = False) -> dict[int, ServoFound]:
    return run_to_end(survey(dynamixels.open_bus(), SERVOS, simulated=simulated))


def set_register(dynamixels: SteppedDynamixels, servo: int, register: Register, value: int) -> None:
    assert dynamixels.servo(servo).write(register, encode(register, value)) == 0


def test_servos_are_found_as_they_are(dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(3).hold()
    found = surveyed(dynamixels)
    assert [each.torque_on for each in found.values()] == [False, False, True, False, False, False]
    assert found[3].goal_ticks == CALIBRATION.joints[2].ticks_from_rad(0.0)
    assert found[3].mode is OperatingMode.EXTENDED_POSITION
    assert (found[1].max_voltage_v, found[3].max_voltage_v) == pytest.approx((14.0, 7.0))
    assert (found[1].current_limit_ma, found[3].current_limit_ma) == (None, 1750)
    assert all(each.warnings == () for each in found.values())


def test_a_goal_is_told_without_the_turns_that_the_servo_counts(dynamixels: SteppedDynamixels) -> None:
    servo = dynamixels.servo(3)
    servo._turns_ticks += 3 * 4096
    servo.hold()
    assert surveyed(dynamixels)[3].goal_ticks == CALIBRATION.joints[2].ticks_from_rad(0.0)


def test_a_dead_bus_of_a_simulated_arm_is_told_without_advice(dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo_bus.faults.offline = {1, 2, 3, 4, 5, 6}
    with pytest.raises(StartupError, match=r"no servo answers$"):
        surveyed(dynamixels, simulated=True)


def test_a_servo_of_another_model_is_refused(dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(3).set(Register.MODEL_NUMBER, 1060)
    with pytest.raises(StartupError, match=r"elbow_flex \(id 3\) is model 1060, not xl330-m288 \(1200\)"):
        surveyed(dynamixels)


@pytest.mark.parametrize(("servo", "mode"), [(1, 1), (1, 5), (3, 0), (3, 16)])
def test_a_servo_that_does_not_follow_positions_is_refused(
    dynamixels: SteppedDynamixels, servo: int, mode: int
) -> None:
    set_register(dynamixels, servo, Register.OPERATING_MODE, mode)
    with pytest.raises(StartupError, match=rf"operating mode {mode}.*OPERATING_MODE \(11\) to 4"):
        surveyed(dynamixels)


def test_a_servo_that_ignores_its_homing_offset_is_refused(dynamixels: SteppedDynamixels) -> None:
    # Of -1700 ticks: its zero would be 150 deg wrong.
    set_register(dynamixels, 3, Register.OPERATING_MODE, OperatingMode.POSITION)
    with pytest.raises(StartupError, match="ignores its homing offset of -1700 ticks"):
        surveyed(dynamixels)


def test_position_mode_is_fine_with_a_small_homing_offset(dynamixels: SteppedDynamixels) -> None:
    set_register(dynamixels, 2, Register.OPERATING_MODE, OperatingMode.POSITION)
    assert surveyed(dynamixels)[2].mode is OperatingMode.POSITION


@pytest.mark.parametrize("drive_mode", [1, 4, 8])
def test_a_drive_mode_that_changes_direction_profile_or_torque_is_refused(
    dynamixels: SteppedDynamixels, drive_mode: int
) -> None:
    set_register(dynamixels, 3, Register.DRIVE_MODE, drive_mode)
    with pytest.raises(StartupError, match=rf"drive mode {drive_mode}.*DRIVE_MODE \(10\) to 0"):
        surveyed(dynamixels)


def test_a_servo_that_was_turned_many_times_is_refused(dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(3)._turns_ticks += 32 * 4096
    with pytest.raises(StartupError, match=r"elbow_flex \(id 3\) is at -\d+ ticks, more than 16 turns away"):
        surveyed(dynamixels)


def test_a_servo_that_stops_answering_is_told(dynamixels: SteppedDynamixels) -> None:
    steps = survey(dynamixels.open_bus(), SERVOS)
    for _ in range(20):
        next(steps)
    dynamixels.servo_bus.faults.offline = {1, 2, 3, 4, 5, 6}
    with pytest.raises(NoReply):
        run_to_end(steps)


def test_limits_of_another_calibration_are_a_warning(dynamixels: SteppedDynamixels) -> None:
    set_register(dynamixels, 2, Register.MIN_POSITION_LIMIT, 1000)
    (warning,) = surveyed(dynamixels)[2].warnings
    assert warning.alert is ServoAlert.POSITION_LIMITS
    assert "(1000, 2790)" in warning.sentence
    assert "(1300, 2790)" in warning.sentence


def test_a_firmware_without_watchdog_is_a_warning(dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(1).set(Register.FIRMWARE_VERSION, 37)
    found = surveyed(dynamixels)
    assert not found[1].has_watchdog
    assert found[3].has_watchdog
    (warning,) = found[1].warnings
    assert warning.alert is ServoAlert.NO_WATCHDOG
    assert "37 has no bus watchdog" in warning.sentence


def test_a_homing_offset_that_is_not_the_calibrations_is_refused(dynamixels: SteppedDynamixels) -> None:
    assert refusal(SERVOS, surveyed(dynamixels)) == ""
    set_register(dynamixels, 3, Register.HOMING_OFFSET, 0)
    reason = refusal(SERVOS, surveyed(dynamixels))
    assert "elbow_flex (id 3) has the homing offset 0" in reason
    assert "calibration says -1700" in reason


def test_a_servo_keeps_to_its_own_limits_in_position_mode_only(dynamixels: SteppedDynamixels) -> None:
    extended = limits_of(SERVOS, 2, surveyed(dynamixels)[2])
    assert extended == SERVOS.unambiguous_ticks(2)
    set_register(dynamixels, 2, Register.OPERATING_MODE, OperatingMode.POSITION)
    assert limits_of(SERVOS, 2, surveyed(dynamixels)[2]) == (1300, 2790)


@pytest.fixture
def checks() -> RegisterChecks:
    made = RegisterChecks(SERVOS)
    made.expect(dict.fromkeys(SERVOS.ids, 0.8))
    return made


def test_every_register_of_every_servo_has_its_turn(checks: RegisterChecks) -> None:
    due = [checks.due() for _ in range(12 * CYCLES_BETWEEN)]
    asked = [each for each in due if each is not None]
    assert len(asked) == 12
    assert set(asked) == {
        (servo, each) for servo in SERVOS.ids for each in (Register.TORQUE_ENABLE, Register.BUS_WATCHDOG)
    }


def test_a_servo_as_it_was_written_is_no_fault(checks: RegisterChecks) -> None:
    assert checks.check_watchdog(3, WATCHDOG, 5.0) is None
    assert checks.check_torque(3, on=True, stamp_s=5.0) is None
    assert checks.torque_on == {3: True}


def test_a_servo_that_was_relaxed_is_a_fault(checks: RegisterChecks) -> None:
    fault = checks.check_torque(3, on=False, stamp_s=5.0)
    assert (fault.code, fault.joint, fault.stamp_s) == (FaultCode.TORQUE_LOST, "elbow_flex", 5.0)


def test_a_servo_with_a_disarmed_watchdog_has_rebooted_once(checks: RegisterChecks) -> None:
    fault = checks.check_watchdog(3, 0, 5.0)
    assert (fault.code, fault.joint) == (FaultCode.SERVO_REBOOTED, "elbow_flex")
    assert checks.check_watchdog(3, 0, 6.0) is None


def test_a_servo_that_its_watchdog_has_stopped_is_a_fault(checks: RegisterChecks) -> None:
    fault = checks.check_watchdog(3, -1, 5.0)
    assert fault.code is FaultCode.SERVO_SILENT
    assert "0.5 s" in fault.message


def test_nothing_is_expected_of_a_servo_that_was_not_driven() -> None:
    assert RegisterChecks(SERVOS).check_watchdog(3, 0, 5.0) is None


def test_only_changed_torque_limits_are_written(checks: RegisterChecks) -> None:
    shares = dict.fromkeys(SERVOS.ids, 0.8)
    assert checks.limits_to_write(shares) == {}
    assert checks.limits_to_write({**shares, 6: 0.4}) == {6: 0.4}
    assert checks.limits_to_write({**shares, 6: 0.4}) == {}
