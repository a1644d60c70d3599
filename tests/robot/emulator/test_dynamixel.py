from typing import Any

import pytest

from robot.emulator import dynamixel
from robot.emulator.plant import Plant
from robot.hardware.dynamixel.family import ALERT
from robot.hardware.dynamixel.registers import MODELS, OperatingMode, Register
from tests.helpers.servo_families import DYNAMIXEL, run


def servo_at(
    position_ticks: float = 2048.0,
    model: str = "xl330-m288",
    offset: int = 0,
    mode: OperatingMode = OperatingMode.EXTENDED_POSITION,
) -> dynamixel.DynamixelServo:
    plant = Plant(position_ticks, position_ticks - 50_000.0, position_ticks + 50_000.0)
    return dynamixel.DynamixelServo(3, MODELS[model], plant, (500, 3500), offset, mode)


read, write = DYNAMIXEL.read, DYNAMIXEL.write


def holding(**kind: Any) -> dynamixel.DynamixelServo:
    servo = servo_at(**kind)
    servo.hold()
    return servo


def test_position_mode_ignores_an_offset_beyond_a_quarter_turn_and_turns_count_until_a_power_cut() -> None:
    for offset, effective in ((1024, 1024), (-1024, -1024), (1025, 0), (-1700, 0)):
        assert servo_at(offset=offset).present_ticks == 2048 + offset
        assert servo_at(offset=offset, mode=OperatingMode.POSITION).present_ticks == 2048 + effective
    servo = holding()
    write(servo, "GOAL_POSITION", 2048 + 4096)
    run(servo, 4.0)
    assert read(servo, "PRESENT_POSITION") == pytest.approx(2048 + 4096, abs=1)
    servo.power_up()
    assert read(servo, "PRESENT_POSITION") == pytest.approx(2048, abs=1)


def test_what_cannot_be_written_is_refused() -> None:
    for register, value, error in (
        ("MODEL_NUMBER", 1, dynamixel.ACCESS_ERROR),
        ("PRESENT_POSITION", 1, dynamixel.ACCESS_ERROR),
        ("GOAL_PWM", 886, dynamixel.DATA_LIMIT_ERROR),
        ("GOAL_CURRENT", -1751, dynamixel.DATA_LIMIT_ERROR),
        ("GOAL_POSITION", 1_048_576, dynamixel.DATA_LIMIT_ERROR),
        ("TORQUE_ENABLE", 2, dynamixel.DATA_LIMIT_ERROR),
        ("BUS_WATCHDOG", -1, dynamixel.DATA_RANGE_ERROR),
    ):
        servo = servo_at()
        before = read(servo, register)
        assert write(servo, register, value) == error
        assert read(servo, register) == before


def test_goals_beyond_the_limits_half_a_register_and_the_eeprom_of_a_driven_servo_are_refused() -> None:
    servo = servo_at(mode=OperatingMode.POSITION)
    assert write(servo, "GOAL_POSITION", 3501) == dynamixel.DATA_LIMIT_ERROR
    assert write(servo, "GOAL_POSITION", 3500) == 0
    for torque, refused in ((1, dynamixel.ACCESS_ERROR), (0, 0)):
        write(servo, "TORQUE_ENABLE", torque)
        assert write(servo, "OPERATING_MODE", 4) == refused
    data = Register.PROFILE_ACCELERATION.encode(7) + Register.PROFILE_VELOCITY.encode(8)
    assert servo.write(Register.PROFILE_ACCELERATION, data[:6]) == dynamixel.DATA_LENGTH_ERROR
    assert read(servo, "PROFILE_ACCELERATION") == 0
    assert servo.write(Register.PROFILE_ACCELERATION, data) == 0
    assert (read(servo, "PROFILE_ACCELERATION"), read(servo, "PROFILE_VELOCITY")) == (7, 8)
    for address in (66, 300):
        assert (servo.read(address, 2), servo.write(address, b"\1")) == (b"\0\0", dynamixel.ACCESS_ERROR)
    # An XL430 has no current.
    servo = servo_at(model="xl430-w250")
    assert write(servo, "GOAL_CURRENT", 100) == dynamixel.ACCESS_ERROR
    assert read(servo, "CURRENT_LIMIT") == 0


def test_a_change_of_mode_resets_limits_and_profile_and_a_blocked_servo_pushes_with_its_current_limit() -> None:
    servo = servo_at()
    write(servo, "GOAL_CURRENT", 300)
    write(servo, "PROFILE_VELOCITY", 30)
    write(servo, "OPERATING_MODE", 5)
    assert (read(servo, "GOAL_CURRENT"), read(servo, "PROFILE_VELOCITY")) == (1750, 0)
    servo.hold()
    servo.plant.block(2100.0)
    write(servo, "GOAL_CURRENT", 367)
    write(servo, "GOAL_POSITION", 3000)
    run(servo, 0.5)
    assert read(servo, "PRESENT_POSITION") == 2100
    assert read(servo, "PRESENT_PWM") == pytest.approx(221, abs=2)
    assert read(servo, "PRESENT_CURRENT") == pytest.approx(367, abs=3)


def test_the_watchdog_stops_a_driven_servo_on_its_way_until_it_is_cleared_and_no_relaxed_one() -> None:
    servo = servo_at()
    write(servo, "BUS_WATCHDOG", 10)
    run(servo, 1.0)
    assert read(servo, "BUS_WATCHDOG") == 10
    servo.hold()
    write(servo, "PROFILE_VELOCITY", 40)
    write(servo, "GOAL_POSITION", 3000)
    servo.hear()
    run(servo, 0.18)
    assert read(servo, "BUS_WATCHDOG") == 10
    run(servo, 0.1)
    assert read(servo, "BUS_WATCHDOG") == -1
    stopped = read(servo, "PRESENT_POSITION")
    run(servo, 1.0)
    assert read(servo, "PRESENT_POSITION") == pytest.approx(stopped, abs=20)
    assert read(servo, "TORQUE_ENABLE") == 1
    assert write(servo, "GOAL_POSITION", 2100) == dynamixel.DATA_RANGE_ERROR
    assert write(servo, "BUS_WATCHDOG", 0) == 0
    assert write(servo, "GOAL_POSITION", 2100) == 0


def test_an_overloaded_servo_switches_itself_off_until_it_reboots_but_not_by_other_errors() -> None:
    servo = holding()
    servo.plant.block(2050.0)
    write(servo, "GOAL_POSITION", 3000)
    run(servo, dynamixel.OVERLOAD_S + 0.2)
    assert read(servo, "HARDWARE_ERROR_STATUS") == 0x20
    assert servo.error == ALERT
    assert read(servo, "TORQUE_ENABLE") == 0
    assert write(servo, "TORQUE_ENABLE", 1) == dynamixel.ACCESS_ERROR
    servo.power_up()
    assert servo.error == 0
    assert write(servo, "TORQUE_ENABLE", 1) == 0
    # SHUTDOWN does not list this error, so torque stays on.
    other = holding(model="xl430-w250")
    other.fail(0x01)
    assert (read(other, "TORQUE_ENABLE"), other.error) == (1, ALERT)


@pytest.mark.parametrize(("quantity", "value", "bit"), [("temperature_c", 71.0, 0x04), ("voltage_v", 7.2, 0x01)])
def test_heat_and_a_wrong_supply_are_hardware_errors_until_a_reboot(quantity: str, value: float, bit: int) -> None:
    servo = servo_at()
    well = dynamixel.DynamixelServo(4, servo.model, servo.plant)
    setattr(servo if quantity == "voltage_v" else servo.motor, quantity, value)
    run(servo, 0.01)
    servo.voltage_v, servo.motor.temperature_c = well.voltage_v, well.motor.temperature_c
    run(servo, 1.0)
    assert read(servo, "HARDWARE_ERROR_STATUS") == bit
    servo.power_up()
    assert read(servo, "HARDWARE_ERROR_STATUS") == 0
