from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.control.checks import refusal
from robot.description import model
from robot.description.limits import JointBounds
from server.moveit.stitching import SAME_RAD, STITCH_SHARE, STITCH_TOLERANCE_RAD, stitched
from tests.helpers.trajectories import smooth_move

ROBOT = model.builtin()
JOINTS = ROBOT.groups["arm"].joints
HOME = dict.fromkeys(JOINTS, 0.0)
BOUNDS = JointBounds.of(ROBOT, JOINTS)
MOTION = smooth_move(dict.fromkeys(JOINTS, (0.0, 0.4)), 2.0)

NEAR = st.floats(-STITCH_TOLERANCE_RAD, STITCH_TOLERANCE_RAD)


def test_a_motion_from_where_the_arm_holds_stays_as_it_is() -> None:
    assert stitched(MOTION, dict.fromkeys(JOINTS, SAME_RAD), ROBOT) is MOTION


@given(st.lists(NEAR, min_size=len(JOINTS), max_size=len(JOINTS)))
def test_a_motion_from_nearby_is_led_in_within_the_limits(held: list[float]) -> None:
    whole = stitched(MOTION, dict(zip(JOINTS, held, strict=True)), ROBOT)
    assert not isinstance(whole, PlanningFailure)
    assert not refusal(whole, JOINTS, BOUNDS, np.array(held))
    lead_s = whole.duration_s - MOTION.duration_s
    speeds = [whole.sample(time_s)[1] for time_s in np.linspace(0.0, lead_s, 20)]
    assert (np.abs(speeds) <= STITCH_SHARE * BOUNDS.max_velocity + 1e-9).all()
    np.testing.assert_allclose(whole.sample(lead_s + 1.0)[0], MOTION.sample(1.0)[0], atol=1e-9)


def test_slow_joints_are_led_in_slowly() -> None:
    slow = {name: replace(joint, max_velocity=0.05) for name, joint in ROBOT.joints.items()}
    whole = stitched(MOTION, dict.fromkeys(JOINTS, 0.04), replace(ROBOT, joints=slow))
    assert not isinstance(whole, PlanningFailure)
    lead_s = whole.duration_s - MOTION.duration_s
    speeds = np.abs([whole.sample(time_s)[1] for time_s in np.linspace(0.0, lead_s, 20)])
    assert speeds.max() <= STITCH_SHARE * 0.05 + 1e-9


@pytest.mark.parametrize("away_rad", [0.06, -1.0])
def test_a_motion_from_far_away_is_refused_with_joint_and_numbers(away_rad: float) -> None:
    refused = stitched(MOTION, {**HOME, "elbow_flex": away_rad}, ROBOT)
    assert isinstance(refused, PlanningFailure)
    assert refused.code is MoveItErrorCode.CONTROL_FAILED
    assert f"elbow_flex at 0.0000 rad, but the arm holds it at {away_rad:.4f} rad" in refused.message
