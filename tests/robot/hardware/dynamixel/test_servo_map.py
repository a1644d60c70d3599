from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.calibration import RAD_PER_TICK, TICKS_PER_TURN
from robot.description.limits import FASTEST_TICKS_S
from robot.hardware.dynamixel.registers import FULL_PWM, TICKS_S_PER_VELOCITY_UNIT
from robot.hardware.dynamixel.servo_map import ServoMap
from robot.messages import GuardLimits
from tests.helpers.dynamixel import BOUNDS, CALIBRATION, NAMES

SERVOS = ServoMap(CALIBRATION, BOUNDS)


@given(st.sampled_from(SERVOS.ids), st.integers(-5, 5), st.data())
def test_turns_that_a_servo_counts_do_not_change_its_position(servo: int, turns: int, data: st.DataObject) -> None:
    lowest, highest = SERVOS.unambiguous_ticks(servo)
    ticks = data.draw(st.integers(lowest, highest))
    assert SERVOS.calibrated_ticks(servo, ticks + turns * TICKS_PER_TURN) == ticks


@given(st.sampled_from(SERVOS.ids))
def test_the_calibrated_range_or_almost_a_turn_is_certain(servo: int) -> None:
    joint = SERVOS.by_id[servo]
    lowest, highest = SERVOS.unambiguous_ticks(servo)
    assert highest - lowest > 0.9 * TICKS_PER_TURN
    assert joint.range_max - joint.range_min > 4000 or (lowest < joint.range_min and joint.range_max < highest)


def test_goals_and_positions_are_those_of_the_calibration() -> None:
    goal_rad = np.array([0.5, -0.4, 0.3, 1.2, -2.0, 0.7])
    ticks = SERVOS.goals_ticks(goal_rad)
    assert list(ticks) == list(SERVOS.ids)
    assert ticks[3] == CALIBRATION.joints[2].ticks_from_rad(0.3)
    assert SERVOS.rad_from_ticks(ticks) == pytest.approx(goal_rad, abs=3 * RAD_PER_TICK)


def test_a_servo_may_be_faster_than_its_joint_but_not_by_much() -> None:
    for joint, speed in zip(CALIBRATION.joints, BOUNDS.max_velocity, strict=True):
        cap_ticks_s = SERVOS.profile_velocity[joint.servo_id] * TICKS_S_PER_VELOCITY_UNIT
        needed_ticks_s = abs(joint.ticks_s_from_rad_s(float(speed)))
        assert needed_ticks_s < cap_ticks_s < 1.4 * needed_ticks_s


def test_no_servo_is_faster_than_the_cap() -> None:
    fast = ServoMap(CALIBRATION, replace(BOUNDS, max_velocity=np.full(6, 100.0)))
    assert max(fast.profile_velocity.values()) * TICKS_S_PER_VELOCITY_UNIT < FASTEST_TICKS_S + 20


def test_the_gripper_has_a_torque_limit_of_its_own() -> None:
    servos = ServoMap(CALIBRATION, BOUNDS, GuardLimits(torque_limit=0.7, gripper_torque_limit=0.4))
    assert servos.full_torque == pytest.approx([0.7] * 5 + [0.4])
    assert servos.full_share(6) == 0.4


def test_velocities_and_duties_have_the_joints_signs() -> None:
    unit_rad_s = TICKS_S_PER_VELOCITY_UNIT * RAD_PER_TICK
    assert SERVOS.velocities_rad_s([10] * 6)[:5] == pytest.approx([10 * unit_rad_s] * 5)
    mirrored = tuple(
        replace(joint, drive_mode=1) if joint.joint == "gripper" else joint for joint in CALIBRATION.joints
    )
    servos = ServoMap(replace(CALIBRATION, joints=mirrored), BOUNDS)
    assert servos.velocities_rad_s([10] * 6)[5] < 0.0
    assert servos.loads([FULL_PWM] * 6) == pytest.approx([1.0] * 5 + [-1.0])
    assert servos.currents_a([0.5] * 6) == pytest.approx([0.5] * 5 + [-0.5])


def test_soft_limits_are_ranges_of_ticks() -> None:
    ranges = SERVOS.ticks_range(BOUNDS)
    for joint, lower, upper in zip(CALIBRATION.joints, BOUNDS.lower_rad, BOUNDS.upper_rad, strict=True):
        assert ranges[joint.servo_id] == (joint.ticks_from_rad(float(lower)), joint.ticks_from_rad(float(upper)))


def test_a_servo_is_named_by_its_joint() -> None:
    assert SERVOS.label(3) == "elbow_flex (id 3)"
    assert SERVOS.names == NAMES
