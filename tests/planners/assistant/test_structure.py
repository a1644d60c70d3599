import xml.etree.ElementTree as ET

import pytest

from planners.assistant.draft import Tree, find_structure
from planners.errors import AssistantError
from robot.description import model, robot_folder
from tests.helpers.robots import SEVEN_JOINT_URDF
from tests.helpers.stl_arm import URDF


def tree_of(urdf: str) -> tuple[Tree, frozenset[str]]:
    root = ET.fromstring(urdf)
    movable = next(
        joint.get("name")
        for joint in root.iterfind("joint")
        if joint.get("type") != "fixed" and joint.find("mimic") is None
    )
    arm = model.parse(urdf, f'<robot name="r"><group name="g"><joint name="{movable}"/></group></robot>')
    shaped = frozenset(link.get("name") for link in root.iterfind("link") if link.find("collision") is not None)
    return Tree(arm.links, arm.joints), shaped


def structure_of(urdf: str, base=None, tip=None):
    return find_structure(*tree_of(urdf), base, tip)


def test_two_fingers_are_the_gripper_and_the_tool_frame_is_the_tip():
    found = structure_of(URDF)
    assert found.arm_joints == ("turn", "lift", "bend", "roll")
    assert found.gripper_joints == ("left_finger", "right_finger")
    assert (found.base_link, found.hand_link, found.tip_link) == ("base", "palm", "tool_point")
    assert found.held_joints == ()


def test_one_jaw_is_the_gripper():
    urdf = robot_folder.built_in("so101").model.urdf
    found = structure_of(urdf)
    built_in = robot_folder.built_in("so101").model
    assert found.arm_joints == built_in.groups["arm"].joints
    assert found.gripper_joints == built_in.gripper.joints
    assert found.tip_link == built_in.tip_link


def test_an_arm_without_fingers_has_no_gripper():
    found = structure_of(SEVEN_JOINT_URDF)
    assert found.arm_joints == ("a1", "a2", "a3", "a4", "a5", "a6", "a7")
    assert found.gripper_joints == ()
    assert found.tip_link == "tool"


def test_a_finger_that_mimics_the_other_has_no_position_of_its_own():
    urdf = URDF.replace('<axis xyz="0 -1 0"/>', '<axis xyz="0 -1 0"/><mimic joint="left_finger"/>')
    assert structure_of(urdf).gripper_joints == ("left_finger",)


def test_joints_before_the_base_are_held():
    found = structure_of(URDF, base="turret")
    assert found.arm_joints == ("lift", "bend", "roll")
    assert found.held_joints == ("turn",)


def test_the_tip_that_is_given_ends_the_arm():
    found = structure_of(URDF, tip="fore")
    assert found.arm_joints == ("turn", "lift", "bend")
    assert found.tip_link == "fore"


@pytest.mark.parametrize(
    ("base", "tip", "reason"),
    [
        ("nowhere", None, "--base nowhere: .* palm"),
        (None, "nowhere", "--tip nowhere: .* palm"),
        ("fore", "turret", "no chain of joints leads from 'fore' to 'turret'"),
        (None, "turret", "has 1 movable joints"),
    ],
)
def test_links_that_make_no_arm_are_refused(base, tip, reason):
    with pytest.raises(AssistantError, match=reason):
        structure_of(URDF, base, tip)
