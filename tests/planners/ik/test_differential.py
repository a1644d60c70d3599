import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.ik.differential import Task, barrier, bounded_least_squares, free_directions, solve, velocity_limit
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


def test_a_task_of_lower_priority_changes_nothing_about_the_first_and_keeps_the_limit():
    chance = np.random.default_rng(2)
    jacobian, angular = chance.normal(size=(2, 3, 6))
    wanted = Task(jacobian, np.array([0.1, 0.2, -0.1]))
    limit = velocity_limit(np.full(6, 0.3))
    first, _ = solve([wanted], 1e-6, limit)
    both, active = solve([Task(angular, np.ones(3))], 1e-3, limit, first, free_directions(jacobian, 1e-6))
    assert jacobian @ both == pytest.approx(wanted.velocity, abs=1e-6)
    assert np.linalg.norm(angular @ both - 1.0) < np.linalg.norm(angular @ first - 1.0)
    assert active.size
    assert np.abs(both).max() <= 0.3 + 1e-9


def test_of_two_tasks_alike_the_costlier_is_met_better():
    tasks = [Task(np.eye(2), np.zeros(2)), Task(np.eye(2), np.ones(2), 3.0)]
    assert solve(tasks, 1e-6)[0] == pytest.approx([0.9, 0.9])


@pytest.mark.parametrize("distance", [0.0, 1e-4, 0.01, 0.3])
def test_behind_a_barrier_a_joint_comes_to_rest_in_time(distance):
    change, period = 0.02, 0.02
    limit = barrier(np.array([distance]), np.array([[-1.0]]), np.array([change]), period, gain=100.0)
    velocity = float(limit.bounds[0])
    way = 0.0
    while velocity > 0.0:
        way += velocity * period
        velocity -= change
    assert way <= distance + 1e-12
    assert limit.rows == pytest.approx(np.array([[1.0]]))
