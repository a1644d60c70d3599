"""Maps of joints: by name, by pairs, scaled, mirrored, and refused in one sentence."""

from __future__ import annotations

import pytest

from server.errors import ServiceError
from server.teleop.leader import joint_map, mirrored_joints
from tests.helpers.robots import so101

ROBOT = so101()
JOINTS = [joint.name for joint in ROBOT.movable_joints]


def test_joints_follow_those_of_the_same_name_below_another_prefix() -> None:
    joints = joint_map(ROBOT, "", [f"leader_{name}" for name in JOINTS], "leader_")
    assert joints.targets_rad({"leader_elbow_flex": 0.3}) == {"elbow_flex": 0.3}
    assert [link.follower for link in joints.links] == JOINTS


def test_scale_is_of_the_arm_and_not_of_the_gripper() -> None:
    joints = joint_map(ROBOT, "", JOINTS, scale=0.5)
    assert joints.targets_rad({"elbow_flex": 0.4, "gripper": 0.4}) == {"elbow_flex": 0.2, "gripper": 0.4}


def test_in_the_mirror_pan_and_roll_turn_the_other_way() -> None:
    assert mirrored_joints(ROBOT) == {"shoulder_pan", "wrist_roll"}
    joints = joint_map(ROBOT, "", JOINTS, mirror=True)
    assert joints.targets_rad({"shoulder_pan": 0.4, "elbow_flex": 0.4}) == {"shoulder_pan": -0.4, "elbow_flex": 0.4}


def test_targets_stay_within_the_followers_limits() -> None:
    pan = ROBOT.joints["shoulder_pan"]
    assert joint_map(ROBOT, "", JOINTS).targets_rad({"shoulder_pan": 9.0}) == {"shoulder_pan": pan.upper}


@pytest.mark.parametrize(("pan_rad", "says"), [(45.0, "45.00 rad"), (-2.5, "-2.50 rad"), (2.0, "")])
def test_a_target_far_beyond_the_range_is_named_with_a_hint_at_degrees(pan_rad: float, says: str) -> None:
    found = joint_map(ROBOT, "", JOINTS).beyond_range({"shoulder_pan": pan_rad})
    assert ("the leader's shoulder_pan leads shoulder_pan" in found and "not in degrees" in found) is bool(says)
    assert says in found


def test_pairs_name_who_follows_whom() -> None:
    joints = joint_map(ROBOT, "", ["a", "b"], pairs=(["b"], ["wrist_roll"]))
    assert joints.targets_rad({"a": 0.1, "b": 0.2}) == {"wrist_roll": 0.2}


@pytest.mark.parametrize(
    ("leader", "pairs", "scale", "said"),
    [
        (["a"], ([], []), 1.0, "leader: has no joint of the follower's"),
        (["a"], (["x"], ["wrist_roll"]), 1.0, "leader_joints: must be of a, not 'x'"),
        (["a"], (["a"], ["x"]), 1.0, "follower_joints: must be of shoulder_pan, .*, not 'x'"),
        (["a"], (["a"], []), 1.0, "follower_joints: must have as many names as leader_joints, 1, not 0"),
        (["a", "b"], (["a", "b"], ["gripper", "gripper"]), 1.0, "follower_joints: must have each joint once"),
        (JOINTS, ([], []), 3.0, "scale: must be above 0 and at most 2, not 3"),
        (JOINTS, ([], []), float("nan"), "scale: must be above 0 and at most 2, not nan"),
    ],
)
def test_a_map_that_does_not_fit_is_refused_with_the_field(
    leader: list[str], pairs: tuple[list[str], list[str]], scale: float, said: str
) -> None:
    with pytest.raises(ServiceError, match=said):
        joint_map(ROBOT, "", leader, scale=scale, pairs=pairs)
