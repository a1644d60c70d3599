from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robot.calibration import RAD_PER_TICK, TICKS_PER_TURN
from robot.description.limits import FASTEST_TICKS_S
from robot.hardware.servos.servo_map import ServoMap
from tests.helpers.servo_families import DYNAMIXEL, Family

DYNAMIXELS = DYNAMIXEL.servo_map


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(goal_rad=st.lists(st.floats(min_value=-1.6, max_value=1.6), min_size=6, max_size=6))
def test_goals_are_written_as_the_calibration_turns_them_into_ticks(family: Family, goal_rad: list[float]) -> None:
    ticks = family.servo_map.goals_ticks(np.array(goal_rad))
    for joint, goal in zip(family.calibration.joints, goal_rad, strict=True):
        # A goal halfway between two ticks may be rounded to either.
        assert ticks[joint.servo_id] == pytest.approx(joint.ticks_from_rad(goal), abs=1)


def test_a_servo_may_be_faster_than_its_joint_but_not_by_much_nor_beyond_what_is_safe(family: Family) -> None:
    for joint, speed in zip(family.calibration.joints, family.bounds.max_velocity, strict=True):
        needed_ticks_s = abs(joint.ticks_s_from_rad_s(float(speed)))
        cap_ticks_s = family.servo_map.speed_ticks_s[joint.servo_id]
        assert needed_ticks_s < cap_ticks_s < 1.4 * needed_ticks_s or cap_ticks_s == FASTEST_TICKS_S
    fast = ServoMap(family.driver, family.calibration, replace(family.bounds, max_velocity=np.full(6, 100.0)))
    assert set(fast.speed_ticks_s.values()) == {FASTEST_TICKS_S}


def test_velocities_and_loads_have_the_joints_signs(family: Family) -> None:
    servos = family.servo_map
    faster = np.subtract(servos.positions_rad([2100] * 6), servos.positions_rad([2000] * 6))
    assert servos.velocities_rad_s([100] * 6) == pytest.approx(faster)
    joints = tuple(
        replace(joint, drive_mode=1) if joint.joint == "gripper" else joint for joint in family.calibration.joints
    )
    mirrored = ServoMap(family.driver, replace(family.calibration, joints=joints), family.bounds)
    assert mirrored.velocities_rad_s([10] * 6)[5] < 0.0
    assert mirrored.signed([0.5] * 6) == pytest.approx([0.5] * 5 + [-0.5])


# Dynamixel alone: turns.


@given(st.sampled_from(DYNAMIXELS.ids), st.integers(-5, 5), st.data())
def test_turns_that_a_servo_counts_do_not_change_its_position(servo: int, turns: int, data: st.DataObject) -> None:
    ticks = data.draw(st.integers(*DYNAMIXELS.certain_ticks(servo)))
    assert DYNAMIXELS.turns_ticks(servo, ticks + turns * TICKS_PER_TURN) == -turns * TICKS_PER_TURN


@given(st.sampled_from(DYNAMIXELS.ids))
def test_the_calibrated_range_or_almost_a_turn_is_certain(servo: int) -> None:
    joint = DYNAMIXELS.by_id[servo]
    lowest, highest = DYNAMIXELS.certain_ticks(servo)
    assert (highest - lowest) * RAD_PER_TICK > 0.9 * 2.0 * np.pi
    assert joint.range_max - joint.range_min > 4000 or (lowest < joint.range_min and joint.range_max < highest)
