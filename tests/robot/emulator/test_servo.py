"""What servos of every family do alike."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.feetech import MEMORY_BYTES
from robot.emulator.servo import Memory
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
