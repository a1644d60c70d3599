from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.messages import ArmState, Course, Mode, Pace
from server.moveit.handing_over import HORIZON_S, Branch, branch_of
from tests.helpers.trajectories import smooth_move

MOTION = smooth_move({"a": (0.0, 1.0), "b": (0.5, -0.5)}, 2.0)
MOVING = ArmState(0.0, Mode.MOVING, ("a", "b"), fraction=0.5)


@given(st.floats(0.0, 0.9), st.floats(0.0, 1.0), st.floats(0.1, 1.0))
def test_the_lead_is_the_same_curve_as_the_motion_up_to_where_it_is_left(
    fraction: float, share: float, speed: float
) -> None:
    branch = branch_of(MOTION, replace(MOVING, fraction=fraction, pace=Pace(speed)), 0.0)
    assert branch is not None
    time_s = share * branch.lead.duration_s
    # Each derivative of a short piece has more of the rounding.
    for order, (ours, theirs) in enumerate(
        zip(branch.lead.sample(time_s), MOTION.sample(branch.from_s + time_s), strict=True)
    ):
        np.testing.assert_allclose(ours, theirs, atol=(1e-9, 1e-6, 1e-3)[order])
    # There is the whole horizon to plan in, at whatever speed the motion is played.
    left_s = branch.from_s + branch.lead.duration_s - fraction * MOTION.duration_s
    assert left_s == pytest.approx(HORIZON_S * speed)


def test_the_age_of_the_state_counts() -> None:
    fresh, old = branch_of(MOTION, MOVING, 0.0), branch_of(MOTION, MOVING, 0.05)
    assert fresh is not None
    assert old is not None
    assert old.from_s - fresh.from_s == pytest.approx(0.05)


STILL = {
    "not moving": replace(MOVING, mode=Mode.HOLDING),
    "paused": replace(MOVING, pace=Pace(course=Course.PAUSED)),
    "going back": replace(MOVING, pace=Pace(course=Course.BACK)),
    "at speed 0": replace(MOVING, pace=Pace(0.0)),
    "about to end": replace(MOVING, fraction=0.95),
}


@pytest.mark.parametrize("state", STILL.values(), ids=STILL.keys())
def test_a_motion_that_cannot_be_left_has_no_branch(state: ArmState) -> None:
    assert branch_of(MOTION, state, 0.0) is None


def test_the_next_motion_begins_where_the_lead_ends() -> None:
    branch = branch_of(MOTION, MOVING, 0.0)
    assert isinstance(branch, Branch)
    start = branch.positions_rad
    whole = branch.into(smooth_move({"a": (start["a"], 2.0), "b": (start["b"], 0.0)}, 1.0))
    assert (np.diff(whole.time_s) > 0.0).all()
    assert whole.duration_s == pytest.approx(branch.lead.duration_s + 1.0)
    np.testing.assert_allclose(whole.positions_rad[-1], [2.0, 0.0])
    assert branch.velocities_rad_s["a"] > 0.0 > branch.velocities_rad_s["b"]
