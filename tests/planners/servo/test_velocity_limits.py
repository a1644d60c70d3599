from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.servo.question import ServoLimits, ServoStatus
from planners.servo.velocity_limits import PredictedTip, bounded_least_squares, regularized
from tests.helpers.resources import examples

DAMPING = 0.01


def problem(seed):
    """A problem of five unknowns, some of its inequalities at their bounds from the start."""
    chance = np.random.default_rng(seed)
    bounds = np.maximum(chance.normal(size=12), 0.0)
    return chance.normal(size=(3, 5)), chance.normal(size=3), DAMPING, chance.normal(size=(12, 5)), bounds


@examples(100)
@given(st.integers(0, 10**6))
def test_the_solution_keeps_every_inequality_and_is_optimal(seed):
    matrix, wanted, damping, rows, bounds = problem(seed)
    x, active = bounded_least_squares(matrix, wanted, damping, rows, bounds)
    assert (rows @ x <= bounds + 1e-7).all()
    # Karush, Kuhn and Tucker: what is left of the slope is held by the active inequalities, each pushing back.
    slope = matrix.T @ (wanted - matrix @ x) - damping**2 * x
    pushes = np.linalg.lstsq(rows[active].T, slope, rcond=None)[0]
    assert rows[active].T @ pushes == pytest.approx(slope, abs=1e-5)
    assert (pushes >= -1e-5).all()


def test_without_inequalities_it_is_the_damped_least_squares_solution():
    matrix, wanted, damping, _, _ = problem(1)
    x, active = bounded_least_squares(matrix, wanted, damping, np.zeros((0, 5)), np.zeros(0))
    assert x == pytest.approx(np.linalg.solve(matrix.T @ matrix + damping**2 * np.eye(5), matrix.T @ wanted))
    assert not active.size


def test_at_a_corner_without_room_it_rests():
    x, _ = bounded_least_squares(np.eye(2), np.ones(2), DAMPING, np.eye(2), np.zeros(2))
    assert x == pytest.approx([0.0, 0.0])


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
    return PredictedTip(reach * out + height * up, np.column_stack((reach * side, by_lift, by_bend)))


def ask(bend, desired):
    q = np.array([0.0, 0.0, bend])
    return regularized(leg(q).jacobian, np.array(desired), LIMITS, FASTEST, lambda step: leg(q + step))


def test_far_from_a_singularity_a_wish_is_left_alone():
    found = ask(1.0, (0.1, 0.05, -0.02))
    assert found.status is ServoStatus.NO_WARNING
    assert found.linear_m_s == pytest.approx([0.1, 0.05, -0.02])


def test_motion_towards_a_singularity_slows_down_until_it_ends():
    slowed, halted = ask(0.3, (0.1, 0.0, 0.0)), ask(0.1, (0.1, 0.0, 0.0))
    assert slowed.status is ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY
    assert 0.0 < np.linalg.norm(slowed.linear_m_s) < 0.1
    assert halted.status is ServoStatus.HALT_FOR_SINGULARITY
    assert np.linalg.norm(halted.linear_m_s) < 0.02


def test_motion_out_of_a_singularity_is_free():
    found = ask(0.1, (-0.1, 0.0, 0.0))
    assert found.status is ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY
    assert found.linear_m_s == pytest.approx([-0.1, 0.0, 0.0])


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
