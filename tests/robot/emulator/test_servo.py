from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot.emulator.feetech import MEMORY_BYTES
from robot.emulator.plant import AMBIENT_C, SQUEEZING, STALL_CURRENT_A, WELL_COOLED, Drive, Motor, Plant
from robot.emulator.servo import Memory
from robot.hardware.feetech.registers import TABLE, Register
from robot.hardware.interface import StatusFlag
from tests.helpers.servo_families import OF_BOTH_FAMILIES, Family, run


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
def test_torque_switched_on_with_a_stale_goal_makes_the_arm_jump_and_heat_and_a_wrong_supply_are_reported(
    family: Family,
) -> None:
    servo = family.build(3)
    family.write(servo, "TORQUE_ENABLE", 1)
    run(servo, 0.2)
    assert servo.present_ticks < 2048 - 300
    for name, value, flag in (
        ("voltage_v", 12.6, StatusFlag.VOLTAGE),
        ("temperature_c", 75.0, StatusFlag.TEMPERATURE),
    ):
        servo = family.build(3)
        setattr(servo if name == "voltage_v" else servo.motor, name, value)
        run(servo, 0.01)
        assert (servo.protection.status, servo.error != 0) == (flag, True)


@OF_BOTH_FAMILIES
@pytest.mark.parametrize("cut_power", [lambda servo: servo.power_up(), lambda servo: (servo.unplug(), servo.plug_in())])
def test_a_power_cut_keeps_what_is_stored_alone(family: Family, cut_power: Any) -> None:
    servo = family.build(3)
    stored, (limit, quarter) = family.read(servo, family.stored), family.quarter
    servo.hold()
    family.write(servo, limit, quarter)
    cut_power(servo)
    run(servo, 0.5)
    assert [family.read(servo, name) for name in ("TORQUE_ENABLE", "GOAL_POSITION")] == [0, 0]
    assert family.read(servo, limit) == family.read(servo, family.stored) == stored
    assert (family.read(servo, "ID"), servo.present_ticks) == (3, 2048)


@OF_BOTH_FAMILIES
def test_a_blocked_servo_pushes_with_its_limit_and_measures_its_supply_and_temperature(family: Family) -> None:
    servo = family.build(3)
    servo.voltage_v, servo.motor.temperature_c = 4.9, 41.2
    assert (family.read(servo, family.supply), family.read(servo, "PRESENT_TEMPERATURE")) == (49, 41)
    servo.hold()
    servo.plant.block(2100.0)
    family.write(servo, *family.quarter)
    family.write(servo, "GOAL_POSITION", 3000)
    run(servo, 0.5)
    assert family.read(servo, "PRESENT_POSITION") == 2100
    assert (servo.torque_limit_permille, servo.plant.duty_permille) == pytest.approx((250, 250), abs=1)


@given(st.lists(st.tuples(st.integers(0, 90), st.binary(min_size=1, max_size=20)), max_size=10))
def test_a_value_is_always_that_of_the_bytes_at_most_the_largest(writes: list[tuple[int, bytes]]) -> None:
    memory = Memory(TABLE, MEMORY_BYTES)
    for address, data in writes:
        memory.write(address, data)
        for register in Register:
            assert memory.value(register) == register.decode(memory.read(register, register.size))
    memory.set(Register.PRESENT_LOAD, -5000)
    memory.set(Register.PRESENT_TEMPERATURE, 300)
    assert (memory.value(Register.PRESENT_LOAD), memory.value(Register.PRESENT_TEMPERATURE)) == (-1023, 255)


DT_S = 0.002


def plant_at(ticks, gravity=0.0):
    return Plant(ticks, 100.0, 4000.0, gravity)


def drive_to(goal, velocity=1000.0, acceleration=25_400.0, torque=1000.0):
    return Drive(goal, velocity, acceleration, torque, p_gain=32)


def run_plant(plant, drive, duration_s):
    positions = [plant.position_ticks]
    for _ in range(round(duration_s / DT_S)):
        plant.step(DT_S, drive)
        positions.append(plant.position_ticks)
    return positions


@settings(max_examples=30)
@given(st.floats(100, 4000), st.floats(100, 4000), st.floats(500, 2800), st.floats(500, 25_400))
def test_a_driven_joint_reaches_any_goal_without_passing_its_velocity_limit(start, goal, velocity, acceleration):
    positions = run_plant(plant_at(start), drive_to(goal, velocity, acceleration), 10.0)
    fastest = max(abs(b - a) for a, b in pairwise(positions)) / DT_S
    assert positions[-1] == pytest.approx(goal, abs=0.5)
    assert fastest <= velocity * 1.001
    assert max(positions) <= max(start, goal) + 3.0
    assert min(positions) >= min(start, goal) - 3.0


def test_a_joint_lags_behind_a_moving_goal_by_some_20_ms_and_a_suspended_process_does_not_catch_up():
    plant = plant_at(1000.0)
    run_plant(plant, drive_to(3900.0, velocity=500.0), 1.0)
    before = plant.position_ticks
    ahead = run_plant(plant, drive_to(3900.0, velocity=500.0), 0.5)[-1] - before
    assert ahead == pytest.approx(250.0, rel=0.01)
    assert 10.0 < 500.0 * 1.0 + 1000.0 - before < 30.0
    before = plant.position_ticks
    plant.step(3600.0, drive_to(3900.0, velocity=500.0))
    assert plant.position_ticks < before + 500.0 * 0.11 + 30.0


def test_torque_that_comes_back_starts_from_where_the_joint_is():
    plant = plant_at(2000.0)
    run_plant(plant, drive_to(3000.0), 1.5)
    run_plant(plant, drive_to(3000.0, torque=0.0), 0.1)
    plant.position_ticks = 1000.0
    run_plant(plant, drive_to(3000.0, torque=0.0), 0.01)
    assert run_plant(plant, drive_to(1000.0), 0.5) == pytest.approx([1000.0] * 251)


@pytest.mark.parametrize(("at", "goal", "stops_at"), [(1800.0, 1500.0, 1800.0), (4090.0, 4095.0, 4000.0)])
def test_an_obstacle_may_stand_anywhere_and_widens_no_range(at, goal, stops_at):
    plant = plant_at(2000.0)
    plant.block(at)
    assert run_plant(plant, drive_to(goal), 3.0)[-1] == stops_at


def warm(motor, duration_s, current_a):
    for _ in range(round(duration_s / 0.1)):
        motor.step(0.1, current_a)
    return motor.temperature_c


def test_a_motor_warms_with_the_square_of_its_current_at_its_rate_and_cools_to_the_air():
    assert warm(Motor(), 10.0, 0.0) == AMBIENT_C
    assert AMBIENT_C < warm(Motor(70.0), WELL_COOLED.cooling_s, 0.0) < 48.0
    one, two, back = (warm(Motor(), 1.0, current) - AMBIENT_C for current in (0.5, 1.0, -1.0))
    assert two == pytest.approx(4.0 * one)
    assert two == back > 0.0
    assert warm(Motor(rate=100.0), 1.0, 1.0) == pytest.approx(warm(Motor(), 100.0, 1.0), rel=0.01)
    # A squeezing gripper is at 50 degC within a minute and cools slowly.
    for share, within_s in ((0.25, 60.0), (0.5, 30.0)):
        gripper = Motor(heating=SQUEEZING)
        assert 50.0 < warm(gripper, within_s, share * STALL_CURRENT_A) < 60.0
        assert warm(gripper, 60.0, 0.0) > 48.0
