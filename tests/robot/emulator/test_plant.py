from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot.emulator.plant import (
    AMBIENT_C,
    SQUEEZING,
    STALL_CURRENT_A,
    WELL_COOLED,
    Drive,
    Motor,
    Plant,
)

DT_S = 0.002


def plant_at(ticks, gravity=0.0):
    return Plant(ticks, 100.0, 4000.0, gravity)


def drive_to(goal, velocity=1000.0, acceleration=25_400.0, torque=1000.0):
    return Drive(goal, velocity, acceleration, torque, p_gain=32)


def run(plant, drive, duration_s):
    positions = [plant.position_ticks]
    for _ in range(round(duration_s / DT_S)):
        plant.step(DT_S, drive)
        positions.append(plant.position_ticks)
    return positions


@settings(max_examples=30)
@given(st.floats(100, 4000), st.floats(100, 4000), st.floats(500, 2800), st.floats(500, 25_400))
def test_a_driven_joint_reaches_any_goal_without_passing_its_velocity_limit(start, goal, velocity, acceleration):
    positions = run(plant_at(start), drive_to(goal, velocity, acceleration), 10.0)
    fastest = max(abs(b - a) for a, b in pairwise(positions)) / DT_S
    assert positions[-1] == pytest.approx(goal, abs=0.5)
    assert fastest <= velocity * 1.001
    assert max(positions) <= max(start, goal) + 3.0
    assert min(positions) >= min(start, goal) - 3.0


def test_a_joint_lags_behind_a_moving_goal_by_some_20_ms():
    plant = plant_at(1000.0)
    run(plant, drive_to(3900.0, velocity=500.0), 1.0)
    before = plant.position_ticks
    ahead = run(plant, drive_to(3900.0, velocity=500.0), 0.5)[-1] - before
    assert ahead == pytest.approx(250.0, rel=0.01)
    assert 10.0 < 500.0 * 1.0 + 1000.0 - before < 30.0


def test_torque_that_comes_back_starts_from_where_the_joint_is():
    plant = plant_at(2000.0)
    run(plant, drive_to(3000.0), 1.5)
    run(plant, drive_to(3000.0, torque=0.0), 0.1)
    plant.position_ticks = 1000.0
    run(plant, drive_to(3000.0, torque=0.0), 0.01)
    assert run(plant, drive_to(1000.0), 0.5) == pytest.approx([1000.0] * 251)


def test_a_suspended_process_does_not_catch_up():
    plant = plant_at(1000.0)
    plant.step(3600.0, drive_to(4000.0, velocity=1000.0))
    assert plant.position_ticks < 1000.0 + 1000.0 * 0.11


@pytest.mark.parametrize(
    ("at", "goal", "stops_at"),
    [(1800.0, 1500.0, 1800.0), (4090.0, 4095.0, 4000.0)],
    ids=["below the joint", "beyond the mechanical range"],
)
def test_an_obstacle_may_stand_anywhere_and_widens_no_range(at, goal, stops_at):
    plant = plant_at(2000.0)
    plant.block(at)
    assert run(plant, drive_to(goal), 3.0)[-1] == stops_at


def warm(motor, duration_s, current_a):
    for _ in range(round(duration_s / 0.1)):
        motor.step(0.1, current_a)
    return motor.temperature_c


def test_a_motor_without_current_stays_as_warm_as_the_air_or_cools_to_it():
    assert warm(Motor(), 10.0, 0.0) == AMBIENT_C
    assert AMBIENT_C < warm(Motor(70.0), WELL_COOLED.cooling_s, 0.0) < 48.0


def test_a_motor_warms_with_the_square_of_its_current_whatever_its_sign_and_at_its_rate():
    one, two, back = (warm(Motor(), 1.0, current) - AMBIENT_C for current in (0.5, 1.0, -1.0))
    assert two == pytest.approx(4.0 * one)
    assert two == back > 0.0
    assert warm(Motor(rate=100.0), 1.0, 1.0) == pytest.approx(warm(Motor(), 100.0, 1.0), rel=0.01)


@pytest.mark.parametrize(("share", "within_s"), [(0.25, 60.0), (0.5, 30.0)])
def test_a_squeezing_gripper_is_at_50_degc_within_a_minute_and_cools_slowly(share, within_s):
    gripper = Motor(heating=SQUEEZING)
    assert 50.0 < warm(gripper, within_s, share * STALL_CURRENT_A) < 60.0
    assert warm(gripper, 60.0, 0.0) > 48.0
