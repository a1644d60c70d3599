from __future__ import annotations

import math

import pytest

from robot.commissioning.verify import LIMIT_MARGIN_RAD, Droop, poses, seen_findings
from robot.description import robot_folder
from tests.helpers.robots import so101

NONE: frozenset[str] = frozenset()


@pytest.mark.parametrize("name", ["so100", "so101", "koch_v1_1", "fetch"])
def test_every_candidate_keeps_away_from_the_limits_of_every_built_in_arm(name):
    robot = robot_folder.resolve(name).model
    for pose in poses(robot):
        for candidate in pose.candidates:
            for joint, position in candidate.items():
                low, high = robot.joints[joint].lower, robot.joints[joint].upper
                margin = min(LIMIT_MARGIN_RAD, (high - low) / 2.0)
                assert low + margin - 1e-9 <= position <= high - margin + 1e-9 or joint in robot.gripper.joints


def test_the_poses_beside_zero_show_the_direction_of_every_joint():
    zero, first, second, gripper = (pose.candidates[0] for pose in poses(so101()))
    for joint in zero:
        assert (first[joint] - zero[joint]) * (second[joint] - zero[joint]) < 0.0
        # A hand's breadth, not a swing.
        assert max(abs(first[joint] - zero[joint]), abs(second[joint] - zero[joint])) < 0.5
    assert set(gripper) == {"gripper"}


@pytest.mark.parametrize(
    ("droop", "words"),
    [
        (Droop("elbow_flex", 0.03, load=0.2, p_gain=32), None),
        (Droop("elbow_flex", 0.09, load=0.4, p_gain=16), "its position gain of 16 lets it"),
        (Droop("elbow_flex", -0.12, load=0.05, p_gain=32), f"stands {math.degrees(0.12):.1f} deg from its goal"),
        (Droop("elbow_flex", -0.12, load=0.05, p_gain=32), "supply is weak"),
    ],
    ids=["as its gain lets it", "a low gain", "blocked", "a weak supply"],
)
def test_a_droop_is_explained_by_gain_and_load_or_is_a_finding(droop, words):
    if words is None:
        assert droop.finding() == ""
    else:
        assert words in droop.finding()


A, G = frozenset({"a"}), frozenset({"g"})


@pytest.mark.parametrize(
    ("seen", "words"),
    [
        (
            [("zero", A), ("first", A), ("second", NONE)],
            "in 2 of 3 poses: its zero is off",
        ),
        ([("zero", NONE), ("first", A), ("second", A)], "turns the other way"),
        ([("zero", NONE), ("open gripper", G)], "drive_mode"),
    ],
    ids=["off at zero too", "off beside zero only", "a gripper"],
)
def test_a_joint_that_looks_otherwise_than_the_model_is_a_finding_with_its_cause(seen, words):
    (found,) = seen_findings(seen, G)
    assert words in found
