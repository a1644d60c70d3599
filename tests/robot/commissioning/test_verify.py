from __future__ import annotations

import math

import pytest

from robot.commissioning.verify import BACKLASH_RAD, LIMIT_MARGIN_RAD, Droop, poses, seen_findings
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


def test_an_arm_that_hangs_as_far_as_its_gain_lets_it_has_no_finding():
    assert Droop("elbow_flex", 0.03, load=0.2, p_gain=32).finding() == ""


def test_a_large_droop_that_gain_and_load_explain_names_the_gain():
    droop = Droop("elbow_flex", 0.09, load=0.4, p_gain=16)
    assert droop.explained_rad > 0.09
    assert "its position gain of 16 lets it" in droop.finding()


def test_a_droop_that_they_do_not_explain_names_blockage_and_supply():
    found = Droop("elbow_flex", -0.12, load=0.05, p_gain=32).finding()
    assert f"stands {math.degrees(0.12):.1f} deg from its goal" in found
    assert "supply is weak" in found


def test_half_the_gain_explains_twice_the_droop():
    full, half = (Droop("a", 0.0, load=0.3, p_gain=gain).explained_rad - BACKLASH_RAD for gain in (32, 16))
    assert half == pytest.approx(2.0 * full)


def test_a_joint_that_is_off_at_zero_too_has_a_wrong_zero():
    seen = [("zero", frozenset({"a"})), ("first", frozenset({"a"})), ("second", NONE)]
    (found,) = seen_findings(seen, NONE)
    assert found.startswith("a looks otherwise than the model in 2 of 3 poses: its zero is off")


def test_a_joint_that_is_off_only_beside_zero_turns_the_other_way():
    (found,) = seen_findings([("zero", NONE), ("first", frozenset({"a"})), ("second", frozenset({"a"}))], NONE)
    assert "turns the other way" in found


def test_a_gripper_is_calibrated_by_its_ends():
    (found,) = seen_findings([("zero", NONE), ("open gripper", frozenset({"g"}))], frozenset({"g"}))
    assert "drive_mode" in found


def test_an_arm_that_looks_as_the_model_has_no_finding():
    assert seen_findings([("zero", NONE), ("first", NONE)], NONE) == []
