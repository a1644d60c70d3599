import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.servo.least_squares import bounded_least_squares
from tests.helpers.examples import examples

DAMPING = 0.01


def problem(seed):
    """A problem of five unknowns, some of its inequalities at their bounds from the start."""
    chance = np.random.default_rng(seed)
    bounds = np.maximum(chance.normal(size=12), 0.0)
    return chance.normal(size=(3, 5)), chance.normal(size=3), DAMPING, chance.normal(size=(12, 5)), bounds


@examples(100)
@given(st.integers(0, 10**6))
def test_what_is_found_keeps_every_inequality_and_nothing_pulls_it_further(seed):
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
