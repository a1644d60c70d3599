import xml.etree.ElementTree as ET

import pytest

from planners.assistant.draft import Tree, find_structure
from planners.errors import AssistantError
from robot.description import model, robot_folder
from tests.helpers.robots import SEVEN_JOINT_URDF
from tests.helpers.stl_arm import URDF


def structure_of(urdf: str, base=None, tip=None):
    root = ET.fromstring(urdf)
    movable = (each for each in root.iterfind("joint") if each.get("type") != "fixed" and each.find("mimic") is None)
    joint = next(movable).get("name")
    arm = model.parse(urdf, f'<robot name="r"><group name="g"><joint name="{joint}"/></group></robot>')
    shaped = frozenset(link.get("name") for link in root.iterfind("link") if link.find("collision") is not None)
    return find_structure(Tree(arm.links, arm.joints), shaped, base, tip)


def test_two_fingers_or_one_jaw_are_the_gripper_and_the_tool_frame_is_the_tip():
    found = structure_of(URDF)
    assert found.arm_joints == ("turn", "lift", "bend", "roll")
    assert found.gripper_joints == ("left_finger", "right_finger")
    assert (found.base_link, found.hand_link, found.tip_link) == ("base", "palm", "tool_point")
    assert found.held_joints == ()
    so101 = robot_folder.built_in("so101").model
    found = structure_of(so101.urdf)
    assert (found.arm_joints, found.tip_link) == (so101.groups["arm"].joints, so101.tip_link)
    assert found.gripper_joints == so101.gripper.joints
    # A finger that mimics the other has no position of its own.
    mimicking = URDF.replace('<axis xyz="0 -1 0"/>', '<axis xyz="0 -1 0"/><mimic joint="left_finger"/>')
    assert structure_of(mimicking).gripper_joints == ("left_finger",)


def test_an_arm_without_fingers_has_no_gripper():
    found = structure_of(SEVEN_JOINT_URDF)
    assert found.arm_joints == ("a1", "a2", "a3", "a4", "a5", "a6", "a7")
    assert (found.gripper_joints, found.tip_link) == ((), "tool")


def test_joints_before_the_base_that_is_given_are_held_and_the_tip_that_is_given_ends_the_arm():
    found = structure_of(URDF, base="turret")
    assert (found.arm_joints, found.held_joints) == (("lift", "bend", "roll"), ("turn",))
    found = structure_of(URDF, tip="fore")
    assert (found.arm_joints, found.tip_link) == (("turn", "lift", "bend"), "fore")


def test_links_that_make_no_arm_are_refused():
    for base, tip, reason in (
        ("nowhere", None, "--base nowhere: .* palm"),
        (None, "nowhere", "--tip nowhere: .* palm"),
        ("fore", "turret", "no chain of joints leads from 'fore' to 'turret'"),
        (None, "turret", "has 1 movable joints"),
    ):
        with pytest.raises(AssistantError, match=reason):
            structure_of(URDF, base, tip)
