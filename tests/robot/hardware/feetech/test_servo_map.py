from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.description.limits import FASTEST_TICKS_S
from robot.hardware.feetech.registers import goal_block
from robot.hardware.feetech.servo_map import SERVO_ACCELERATION, ServoMap
from robot.messages import GuardLimits
from tests.helpers.arm_rig import BOUNDS, CALIBRATION

SERVOS = ServoMap(CALIBRATION, BOUNDS)


@given(st.lists(st.floats(min_value=-1.6, max_value=1.6), min_size=6, max_size=6))
def test_goals_are_written_as_the_calibration_turns_them_into_ticks(goal_rad: list[float]) -> None:
    blocks = SERVOS.goal_blocks(np.array(goal_rad))
    for joint, goal in zip(CALIBRATION.joints, goal_rad, strict=True):
        cap = SERVOS.cap_ticks_s[joint.servo_id]
        exact = joint.ticks_from_rad(goal)
        near = [goal_block(ticks, cap, SERVO_ACCELERATION) for ticks in (exact - 1, exact, exact + 1)]
        # A goal halfway between two ticks may be rounded to either.
        assert blocks[joint.servo_id] in near


@given(st.lists(st.integers(min_value=100, max_value=4000), min_size=6, max_size=6))
def test_ticks_survive_the_way_to_radians_and_back(ticks: list[int]) -> None:
    blocks = SERVOS.goal_blocks(np.array(SERVOS.positions_rad(ticks)))
    assert [block[1] | block[2] << 8 for block in blocks.values()] == ticks


def test_velocity_caps_leave_room_above_the_limit_but_not_beyond_what_is_safe() -> None:
    for joint, speed in zip(CALIBRATION.joints, BOUNDS.max_velocity, strict=True):
        cap = SERVOS.cap_ticks_s[joint.servo_id]
        assert cap <= FASTEST_TICKS_S
        assert cap > joint.ticks_s_from_rad_s(float(speed)) or cap == FASTEST_TICKS_S


def test_velocities_have_the_scale_of_positions() -> None:
    faster = np.subtract(SERVOS.positions_rad([2100] * 6), SERVOS.positions_rad([2000] * 6))
    assert SERVOS.velocities_rad_s([100] * 6) == pytest.approx(faster)


def test_the_servos_push_as_hard_as_is_set_and_the_gripper_less() -> None:
    assert SERVOS.full_torque.tolist() == [800] * 5 + [500]
    gentle = ServoMap(CALIBRATION, BOUNDS, GuardLimits(torque_limit=0.6, gripper_torque_limit=0.29))
    assert gentle.full_torque.tolist() == [600] * 5 + [290]
