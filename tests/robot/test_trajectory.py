from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.trajectory import Trajectory
from tests.helpers.trajectories import smooth_move


@given(st.floats(min_value=-1.0, max_value=5.0))
def test_velocity_is_the_derivative_of_position(time_s: float) -> None:
    trajectory = smooth_move({"shoulder_pan": (0.0, 1.0), "elbow_flex": (0.4, -0.3)}, duration_s=2.0)
    step_s = 1e-5
    before, after = trajectory.sample(time_s - step_s)[0], trajectory.sample(time_s + step_s)[0]
    slope = (after - before) / (2.0 * step_s)
    if step_s < time_s < 2.0 - step_s:
        assert trajectory.sample(time_s)[1] == pytest.approx(slope, abs=1e-3)
    else:
        assert slope == pytest.approx(np.zeros(2), abs=1e-3)


def test_samples_are_met_exactly() -> None:
    trajectory = smooth_move({"shoulder_pan": (0.0, 1.0)}, duration_s=1.0)
    for time_s, position in zip(trajectory.time_s, trajectory.positions_rad, strict=True):
        assert trajectory.sample(float(time_s))[0] == pytest.approx(position)


def test_a_single_sample_lasts_no_time() -> None:
    zero = np.zeros((1, 1))
    trajectory = Trajectory(("shoulder_pan",), np.zeros(1), zero + 0.3, zero, zero)
    assert trajectory.duration_s == 0.0
    assert trajectory.sample(0.5)[0] == pytest.approx([0.3])
