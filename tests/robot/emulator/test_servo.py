"""What servos of every family do alike."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.feetech import MEMORY_BYTES
from robot.emulator.servo import Memory, Protection, Thresholds
from robot.hardware.feetech.registers import TABLE, Register, decode
from robot.hardware.interface import StatusFlag
from tests.helpers.emulated_family import OF_BOTH_FAMILIES, Family, run


@OF_BOTH_FAMILIES
def test_a_driven_servo_goes_to_its_goal_within_its_velocity_and_shows_the_motion(family: Family) -> None:
    servo = family.build(3)
    servo.hold()
    name, ticks_s = family.velocity
    family.write(servo, name, round(600 / ticks_s))
    family.write(servo, "GOAL_POSITION", 3000)
    run(servo, 1.0)
    assert family.read(servo, "PRESENT_POSITION") == pytest.approx(2048 + 600, abs=40)
    assert family.read(servo, "PRESENT_VELOCITY") * ticks_s == pytest.approx(600, abs=30)
    assert family.read(servo, "MOVING") == 1
    run(servo, 2.0)
    assert family.read(servo, "PRESENT_POSITION") == pytest.approx(3000, abs=1)
    assert (family.read(servo, "MOVING"), family.read(servo, "PRESENT_VELOCITY")) == (0, 0)


@OF_BOTH_FAMILIES
def test_a_relaxed_servo_stays_where_it_is(family: Family) -> None:
    servo = family.build(3)
    family.write(servo, "GOAL_POSITION", 3000)
    run(servo, 1.0)
    assert family.read(servo, "PRESENT_POSITION") == 2048


@OF_BOTH_FAMILIES
def test_torque_switched_on_with_a_stale_goal_makes_the_arm_jump(family: Family) -> None:
    servo = family.build(3)
    family.write(servo, "TORQUE_ENABLE", 1)
    run(servo, 0.2)
    assert servo.present_ticks < 2048 - 300


@OF_BOTH_FAMILIES
@pytest.mark.parametrize("cut_power", [lambda servo: servo.power_up(), lambda servo: (servo.unplug(), servo.plug_in())])
def test_a_power_cut_keeps_what_is_stored_alone(family: Family, cut_power: Any) -> None:
    servo = family.build(3)
    stored, (limit, quarter) = family.read(servo, family.stored), family.limit
    servo.hold()
    family.write(servo, limit, quarter)
    cut_power(servo)
    run(servo, 0.5)
    assert [family.read(servo, name) for name in ("TORQUE_ENABLE", "GOAL_POSITION")] == [0, 0]
    assert family.read(servo, limit) == family.read(servo, family.stored) == stored
    assert (family.read(servo, "ID"), servo.present_ticks) == (3, 2048)


@OF_BOTH_FAMILIES
def test_a_blocked_servo_pushes_with_its_limit(family: Family) -> None:
    servo = family.build(3)
    servo.hold()
    servo.plant.block(2100.0)
    family.write(servo, *family.limit)
    family.write(servo, "GOAL_POSITION", 3000)
    run(servo, 0.5)
    assert family.read(servo, "PRESENT_POSITION") == 2100
    assert servo.torque_limit_permille == pytest.approx(250, abs=1)
    assert servo.plant.duty_permille == pytest.approx(250, abs=1)


@OF_BOTH_FAMILIES
def test_a_servo_that_holds_stays_with_the_torque_that_it_was_given(family: Family) -> None:
    servo = family.build(3)
    servo.hold(0.25)
    run(servo, 0.5)
    name, quarter = family.limit
    assert (servo.present_ticks, family.read(servo, name)) == (2048, pytest.approx(quarter, abs=1))


@OF_BOTH_FAMILIES
def test_supply_and_temperature_are_measured(family: Family) -> None:
    servo = family.build(3)
    servo.voltage_v, servo.motor.temperature_c = 4.9, 41.2
    assert (family.read(servo, family.supply), family.read(servo, "PRESENT_TEMPERATURE")) == (49, 41)


@OF_BOTH_FAMILIES
@pytest.mark.parametrize(
    ("quantity", "value", "flag"),
    [("voltage_v", 12.6, StatusFlag.VOLTAGE), ("temperature_c", 75.0, StatusFlag.TEMPERATURE)],
)
def test_heat_and_a_wrong_supply_are_reported(family: Family, quantity: str, value: float, flag: StatusFlag) -> None:
    servo = family.build(3)
    setattr(servo if quantity == "voltage_v" else servo.motor, quantity, value)
    run(servo, 0.01)
    assert servo.protection.status == flag
    assert servo.error != 0


@OF_BOTH_FAMILIES
@pytest.mark.parametrize("name", ["MODEL_NUMBER", "PRESENT_POSITION"])
def test_what_is_read_only_keeps_its_value(family: Family, name: str) -> None:
    servo = family.build(3)
    before = family.read(servo, name)
    family.write(servo, name, 1)
    assert family.read(servo, name) == before


@OF_BOTH_FAMILIES
def test_addresses_beyond_the_memory_read_as_zero(family: Family) -> None:
    assert family.build(3).read(family.codec.word_bytes * 128, 10) == bytes(10)
    assert len(family.build(3).read(0, 255)) == 255


@given(st.lists(st.tuples(st.integers(0, 90), st.binary(min_size=1, max_size=20)), max_size=10))
def test_a_value_is_always_that_of_the_bytes(writes: list[tuple[int, bytes]]) -> None:
    memory = Memory(TABLE, MEMORY_BYTES)
    for address, data in writes:
        memory.write(address, data)
        for register in Register:
            assert memory.value(register) == decode(register, memory.read(register, register.layout.size))


def test_a_value_beyond_the_range_of_its_register_shows_as_the_largest() -> None:
    memory = Memory(TABLE, MEMORY_BYTES)
    memory.set(Register.PRESENT_LOAD, -5000)
    memory.set(Register.PRESENT_TEMPERATURE, 300)
    assert (memory.value(Register.PRESENT_LOAD), memory.value(Register.PRESENT_TEMPERATURE)) == (-1023, 255)


def test_a_block_has_the_registers_that_lie_wholly_inside_it() -> None:
    block = bytes([254, 0x05, 0x80, 0, 0, 0xBC])
    assert Memory(TABLE, MEMORY_BYTES).decode_block(Register.ACCELERATION, block) == {
        Register.ACCELERATION: 254,
        Register.GOAL_POSITION: -5,
        Register.GOAL_TIME: 0,
    }


LIMITS = Thresholds(
    voltage_v=(4.0, 8.0),
    temperature_c=70.0,
    load_permille=800.0,
    overload_s=2.0,
    current_a=3.25,
    overcurrent_s=2.0,
    latching=StatusFlag.CURRENT | StatusFlag.OVERLOAD,
)
WELL = {"load_permille": 100.0, "current_a": 0.2, "temperature_c": 30.0, "voltage_v": 5.0}
STUCK = {**WELL, "load_permille": -900.0}
SHORTED = {**WELL, "current_a": -3.5}


def after(duration_s: float, measured: dict[str, float], protection: Protection | None = None) -> Protection:
    protection = protection or Protection()
    for _ in range(round(duration_s / 0.01)):
        protection.step(0.01, LIMITS, **measured)
    return protection


def test_a_pause_in_the_load_starts_the_timer_again() -> None:
    protection = after(1.5, STUCK)
    after(0.02, WELL, protection)
    assert after(1.5, STUCK, protection).status == 0


@pytest.mark.parametrize(("trouble", "flag"), [(STUCK, StatusFlag.OVERLOAD), (SHORTED, StatusFlag.CURRENT)])
def test_trouble_is_detected_after_its_time_and_outlasts_its_cause_until_torque_is_off(
    trouble: dict[str, float], flag: StatusFlag
) -> None:
    assert after(1.9, trouble).status == 0
    protection = after(2.1, trouble)
    assert after(1.0, WELL, protection).status == flag
    protection.torque_off()
    assert after(0.01, WELL, protection).status == 0


def test_a_servo_may_latch_until_its_power_is_cut() -> None:
    protection = after(3.0, STUCK)
    protection.latches = True
    protection.torque_off()
    assert after(1.0, WELL, protection).status == StatusFlag.OVERLOAD
    protection.power_up()
    assert after(1.0, WELL, protection).status == 0


@pytest.mark.parametrize(
    ("trouble", "flag"),
    [
        ({"voltage_v": 3.9}, StatusFlag.VOLTAGE),
        ({"voltage_v": 12.0}, StatusFlag.VOLTAGE),
        ({"temperature_c": 70.1}, StatusFlag.TEMPERATURE),
    ],
)
def test_errors_that_do_not_latch_last_as_long_as_their_cause(trouble: dict[str, float], flag: StatusFlag) -> None:
    protection = after(0.01, {**WELL, **trouble})
    assert protection.status == flag
    assert after(0.01, WELL, protection).status == 0


def test_a_forced_error_outlasts_everything() -> None:
    protection = Protection()
    protection.forced = StatusFlag.ENCODER
    protection.power_up()
    assert after(0.1, WELL, protection).status == StatusFlag.ENCODER
    protection.torque_off()
    assert after(0.1, WELL, protection).status == StatusFlag.ENCODER
