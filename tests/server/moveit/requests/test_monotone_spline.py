from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.trajectory import Trajectory
from server.moveit.requests.trajectories import knot_accelerations, knot_velocities
from tests.helpers.examples import examples

SPANS = st.lists(st.floats(0.05, 3.0), min_size=1, max_size=8)


def through(time_s, positions):
    positions = np.asarray(positions, float).reshape(len(time_s), -1)
    velocities = knot_velocities(np.asarray(time_s, float), positions)
    accelerations = knot_accelerations(np.asarray(time_s, float), positions, velocities)
    names = tuple(f"j{i}" for i in range(positions.shape[1]))
    return Trajectory(names, np.asarray(time_s, float), positions, velocities, accelerations)


@examples(60)
@given(SPANS, st.randoms(use_true_random=False))
def test_the_curve_stays_between_each_two_points(spans, random) -> None:
    time_s = np.concatenate(([0.0], np.cumsum(spans)))
    curve = through(time_s, [random.uniform(-2.0, 2.0) for _ in time_s])
    for i in range(len(spans)):
        values = [curve.sample(t)[0][0] for t in np.linspace(time_s[i], time_s[i + 1], 12)]
        ends = curve.positions_rad[i : i + 2, 0]
        assert min(ends) - 1e-9 <= min(values)
        assert max(values) <= max(ends) + 1e-9


def test_it_begins_and_ends_at_rest_and_rests_where_it_turns_round() -> None:
    curve = through([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 0.5, 0.7])
    assert curve.velocities_rad_s[[0, 1, 2, 3], 0].tolist() == [0.0, 0.0, 0.0, 0.0]


def test_points_on_a_line_are_passed_at_its_speed() -> None:
    curve = through([0.0, 1.0, 2.0, 3.0], [0.0, 0.5, 1.0, 1.5])
    assert curve.velocities_rad_s[1:3, 0] == pytest.approx([0.5, 0.5])


def test_accelerations_at_the_ends_are_those_of_the_curve() -> None:
    curve = through([0.0, 2.0], [0.0, 1.0])
    assert curve.sample(1e-9)[2][0] == pytest.approx(curve.accelerations_rad_s2[0, 0], rel=1e-6)
    assert curve.sample(2.0 - 1e-9)[2][0] == pytest.approx(curve.accelerations_rad_s2[-1, 0], rel=1e-6)


def test_accelerations_are_the_mean_of_those_before_and_after_a_point() -> None:
    time_s, positions = np.array([0.0, 1.0, 3.0]), np.array([[0.0], [1.0], [0.5]])
    velocities = np.array([[0.2], [0.7], [-0.4]])
    accelerations = knot_accelerations(time_s, positions, velocities)
    curve = Trajectory(("j",), time_s, positions, velocities, accelerations)
    around = [curve.sample(1.0 - 1e-9)[2][0], curve.sample(1.0 + 1e-9)[2][0]]
    assert accelerations[1, 0] == pytest.approx(np.mean(around), rel=1e-6)


def test_a_single_point_stands_still() -> None:
    curve = through([0.0], [0.4])
    assert curve.velocities_rad_s.tolist() == curve.accelerations_rad_s2.tolist() == [[0.0]]
