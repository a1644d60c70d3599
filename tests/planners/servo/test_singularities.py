import numpy as np
import pytest

from planners.servo.question import ServoLimits, ServoStatus
from planners.servo.steering import regularized

LIMITS = ServoLimits(singularity_slow=10.0, singularity_stop=20.0)
FASTEST = np.array([2.0, 2.0, 2.0])
UPPER_M, LOWER_M = 0.12, 0.13


def leg(q):
    """A leg that turns about z, and bends in its plane: stretched at q[2] = 0. Its tip and the tip's Jacobian."""
    turn, lift, bend = q
    reach = UPPER_M * np.cos(lift) + LOWER_M * np.cos(lift + bend)
    height = UPPER_M * np.sin(lift) + LOWER_M * np.sin(lift + bend)
    out, side = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([-np.sin(turn), np.cos(turn), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    by_lift = -height * out + reach * up
    by_bend = LOWER_M * (-np.sin(lift + bend) * out + np.cos(lift + bend) * up)
    return reach * out + height * up, np.column_stack((reach * side, by_lift, by_bend))


def ask(bend, desired):
    q = np.array([0.0, 0.0, bend])
    return regularized(leg(q)[1], np.array(desired), LIMITS, FASTEST, lambda step: leg(q + step))


def test_motion_towards_a_singularity_slows_down_until_it_ends():
    slowed, halted = ask(0.3, (0.1, 0.0, 0.0)), ask(0.1, (0.1, 0.0, 0.0))
    assert slowed.status is ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY
    assert 0.0 < np.linalg.norm(slowed.linear_m_s) < 0.1
    assert halted.status is ServoStatus.HALT_FOR_SINGULARITY
    assert np.linalg.norm(halted.linear_m_s) < 0.02


def test_out_of_an_exact_singularity_there_is_a_way_back_and_none_further():
    assert ask(0.0, (-0.1, 0.0, 0.0)).status is ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY
    assert ask(0.0, (0.1, 0.0, 0.0)).status is ServoStatus.HALT_FOR_SINGULARITY


def test_directions_that_are_not_weak_stay_free_at_a_singularity():
    found = ask(0.05, (0.0, 0.1, 0.1))
    assert found.linear_m_s == pytest.approx([0.0, 0.1, 0.1], abs=0.006)


@pytest.mark.parametrize("bend", [0.0, 1e-6, 0.05])
def test_the_followed_share_of_a_command_needs_no_extreme_joint_speed(bend):
    found = ask(bend, (0.1, 0.02, 0.03))
    velocity = np.linalg.pinv(found.jacobian) @ found.linear_m_s
    assert np.abs(velocity).max() < 20.0
