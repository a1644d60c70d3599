"""The reasons themselves are shown by the controller's tests; here is what must be accepted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot import model
from robot.control.acceptance import refusal
from robot.limits import JointBounds
from tests.helpers.trajectories import smooth_move

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
BOUNDS = JointBounds.of(model.builtin(), NAMES)


@given(st.integers(min_value=0, max_value=5), st.booleans())
def test_a_motion_to_the_very_limit_is_accepted(joint: int, upper: bool) -> None:
    end = float((BOUNDS.upper_rad if upper else BOUNDS.lower_rad)[joint])
    move = smooth_move({NAMES[joint]: (0.0, end)}, duration_s=8.0)
    assert refusal(move, NAMES, BOUNDS, np.zeros(6)) == ""


def test_a_refusal_names_joint_value_and_limit() -> None:
    reason = refusal(smooth_move({"elbow_flex": (0.0, 2.5)}, 8.0), NAMES, BOUNDS, np.zeros(6))
    assert "elbow_flex" in reason
    assert "1.692" in reason


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_times_that_are_no_numbers_are_refused(value: float) -> None:
    move = smooth_move({"elbow_flex": (0.0, 0.5)}, 2.0)
    move.time_s[-1] = value
    assert "finite" in refusal(move, NAMES, BOUNDS, np.zeros(6))
