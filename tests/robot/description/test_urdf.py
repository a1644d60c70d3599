"""Files of a robot: URDF, its cameras, and SRDF."""

import math
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from pydantic import ValidationError

from robot.description.camera import Camera
from robot.description.srdf import Semantics, read_srdf
from robot.description.urdf import Joint, JointLimits, Mimic, read_urdf, unit_axis
from robot.errors import DescriptionError

PALM = '<robot name="hand"><link name="palm"/><link name="left"/><link name="right"/><link name="tip"/>'
LEFT_FINGER = """<joint name="grip" type="prismatic"><parent link="palm"/><child link="left"/>
<limit lower="0" upper="0.04" velocity="0.2" effort="1"/></joint>"""
RIGHT_FINGER = """<joint name="other" type="prismatic"><parent link="palm"/><child link="right"/>
<mimic joint="grip" multiplier="-1" offset="0.01"/></joint>"""
LAST_FINGER = """<joint name="last" type="revolute"><parent link="right"/><child link="tip"/>
<mimic joint="other" multiplier="2" offset="0.5"/></joint></robot>"""
HAND = PALM + LEFT_FINGER + RIGHT_FINGER + LAST_FINGER


def tree(text: str, limits: dict[str, JointLimits] | None = None):
    return read_urdf(text, "URDF", limits or {})


def test_a_joint_that_is_fixed_needs_no_direction() -> None:
    fixed = '<joint name="base" type="fixed"><parent link="palm"/><child link="more"/><axis xyz="0 0 0"/></joint>'
    text = HAND.replace("</robot>", f'<link name="more"/>{fixed}</robot>')
    assert "base" in tree(text).joints
    element = next(each for each in ET.fromstring(text).iter("joint") if each.get("name") == "base")
    assert unit_axis(element).tolist() == [1.0, 0.0, 0.0]


def urdf_refusal(text: str) -> str:
    with pytest.raises(DescriptionError) as refused:
        tree(text)
    return str(refused.value)


def test_a_joint_that_mimics_has_no_position_of_its_own_and_follows_the_first_of_a_chain() -> None:
    found = tree(HAND)
    assert [joint.name for joint in found.joints.values() if joint.movable] == ["grip"]
    assert found.joints["other"].mimic == Mimic("grip", -1.0, 0.01)
    mimic = found.joints["last"].mimic
    assert mimic.joint == "grip"
    # The last is twice the other, which is 0.01 less the grip, and 0.5 more.
    assert (mimic.multiplier, mimic.offset) == pytest.approx((-2.0, 0.52))
    # Links come root first and each branch as a whole.
    assert found.links == ("palm", "left", "right", "tip")
    # A continuous joint needs no limit element where its velocity is given.
    text = HAND.replace('type="prismatic"', 'type="continuous"', 1)
    text = text.replace('<limit lower="0" upper="0.04" velocity="0.2" effort="1"/>', "")
    joint = tree(text, {"grip": JointLimits(max_velocity=1.0)}).joints["grip"]
    assert (joint.lower, joint.upper) == (-math.pi, math.pi)
    assert "[joints.grip]" in urdf_refusal(text)


def test_limits_from_beside_the_urdf_replace_its_own_and_a_floating_joint_rests() -> None:
    base = '<joint name="base" type="floating"><parent link="world"/><child link="palm"/></joint>'
    joints = tree(
        # The namespace of xacro alone is no xacro.
        HAND.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')
        .replace('velocity="0.2"', 'velocity="0"')
        .replace("</robot>", f'<link name="world"/>{base}</robot>'),
        {"grip": JointLimits(max_velocity=0.1, max_acceleration=0.3, max_jerk=3.0)},
    ).joints
    grip = joints["grip"]
    assert (grip.max_velocity, grip.max_acceleration, grip.max_jerk) == (0.1, 0.3, 3.0)
    assert not joints["base"].movable


BROKEN_URDF = {
    "velocity zero": (HAND.replace('"0.2"', '"0"'), "not 0: correct it, or set max_velocity in [joints.grip] of robot"),
    "no velocity": (HAND.replace(' velocity="0.2"', ""), "max_velocity in [joints.grip] of robot.toml"),
    "unknown leader": (HAND.replace('mimic joint="grip"', 'mimic joint="grap"'), "names the joint 'grap'"),
    "ring of mimics": (HAND.replace('mimic joint="grip"', 'mimic joint="last"'), "leads back to the joint itself"),
    "two of a name": (HAND.replace('name="other"', 'name="grip"'), "two joints of the name 'grip'"),
    "two links of a name": (HAND.replace('name="tip"/>', 'name="palm"/>', 1), "two links of the name 'palm'"),
    "no name": (re.sub('<robot name="[^"]*"', "<robot", HAND), "<robot> {} has no attribute 'name'"),
    "two parents": (HAND.replace('<child link="tip"/>', '<child link="left"/>'), "'left' is the child of two joints"),
    "unknown type": (HAND.replace('type="revolute"', 'type="hinge"'), "unknown type 'hinge'"),
    "letters": (HAND.replace("<limit", '<axis xyz="a b c"/><limit', 1), "'grip' <axis> xyz must be 3 finite numbers"),
    "no direction": (HAND.replace("<limit", '<axis xyz="0 0 0"/><limit', 1), "<axis> xyz must not be 0 0 0"),
    "a number too few": (HAND.replace("<limit", '<origin rpy="0 0"/><limit', 1), "<origin> rpy must be 3 finite"),
    "an underscore": (HAND.replace('"0.2"', '"1_0"'), "velocity must be a finite number, not '1_0'"),
    "no end": (HAND.replace('"0.04"', '"1e308"'), "upper must be a finite number, not '1e308'"),
    "a shape": (
        HAND.replace('"palm"/>', '"palm"><collision><geometry><sphere radius="nan"/></geometry></collision></link>', 1),
        "link 'palm' <sphere> radius must be a finite number, not 'nan'",
    ),
    "links without end": (HAND.replace("</robot>", '<link name="a"/>' * 500 + "</robot>"), "504 links, 500 are"),
    "ring of links": (HAND.replace('<parent link="right"/>', '<parent link="tip"/>'), "to one another in a ring"),
}


@pytest.mark.parametrize(("text", "words"), BROKEN_URDF.values(), ids=BROKEN_URDF)
def test_a_broken_urdf_is_refused_with_its_element(text: str, words: str) -> None:
    assert words in urdf_refusal(text)


def test_a_position_that_may_be_in_degrees_gets_a_hint() -> None:
    for type_, position, hinted in (
        *(("revolute", degrees, True) for degrees in (20.0, -45.0)),
        *(("revolute", other, False) for other in (3.0, 400.0)),
        ("prismatic", 20.0, False),
    ):
        joint = Joint("elbow", type_, "a", "b", -1.0, 1.0, 1.0, 1.0)
        assert bool(joint.degrees_hint(position)) is hinted, (type_, position)
    hint = Joint("elbow", "revolute", "a", "b", -1.0, 1.0, 1.0, 1.0).degrees_hint(20.0)
    assert hint == "; positions are in radians: 20 degrees are 0.3491 rad"


AHEAD = (0.5, 0.0, 0.2, 0.0, 0.0, 0.2)


def test_the_image_is_upright_and_shows_its_target_in_the_middle_as_large_as_the_field_of_view() -> None:
    camera, below = Camera(view=AHEAD), Camera(view=(0.0, 0.0, 0.5, 0.0, 0.0, 0.0))
    assert camera.axes == pytest.approx(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert below.axes[:, 2] == pytest.approx([0.0, 0.0, 1.0])
    for each in (camera, below):
        assert np.linalg.det(each.axes) == pytest.approx(1.0)
    # The optical frame has z along the view and y down.
    transform = camera.transform_optical_to_frame
    assert transform @ (0.0, 0.0, 0.5, 1.0) == pytest.approx((*AHEAD[3:], 1.0))
    assert transform[:3, 1] == pytest.approx([0.0, 0.0, -1.0])
    column, row, depth = Camera(view=AHEAD, field_of_view_deg=90.0).intrinsic_matrix @ (0.0, -1.0, 1.0)
    # The middle of the first pixel is (0, 0), and its upper edge half a pixel above.
    assert (column / depth, row / depth) == pytest.approx((159.5, -0.5))


def test_a_wrong_value_is_named() -> None:
    for values, named in (
        ({"view": (0.1,) * 6}, "must look at another point"),
        ({"view": (1.0, 2.0)}, "view"),
        ({"view": (*AHEAD[:5], float("nan"))}, "view.5"),
        ({"width": 321}, "multiple of 2"),
        ({"width": 1282}, "1280"),
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"field_of_view_deg": 180.0}, "field_of_view_deg"),
        ({"colour": "red"}, "colour"),
    ):
        with pytest.raises(ValidationError, match=named):
            Camera(**{"view": AHEAD, **values})


LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", more: str = LIMIT) -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{more}</joint>'


LINKS = "".join(
    f'<link name="{name}"/>' for name in ("base", "torso", "l1", "l2", "l_tool", "r1", "r2", "jaw", "thumb")
)
TREE = read_urdf(
    f'<robot name="two_arms">{LINKS}'
    + joint("lift", "base", "torso")
    + joint("l_shoulder", "torso", "l1")
    + joint("l_elbow", "l1", "l2")
    + joint("l_mount", "l2", "l_tool", "fixed", "")
    + joint("r_shoulder", "torso", "r1")
    + joint("r_elbow", "r1", "r2")
    + joint("grip", "r2", "jaw")
    + joint("thumb", "r2", "thumb", more='<mimic joint="grip"/>')
    + "</robot>",
    "URDF",
    {},
)
LEFT = '<group name="left"><chain base_link="torso" tip_link="l_tool"/></group>'
RIGHT = '<group name="right"><joint name="r_elbow"/><joint name="r_shoulder"/></group>'
BOTH = ("l_shoulder", "l_elbow", "r_shoulder", "r_elbow")


def read(inner: str) -> Semantics:
    return read_srdf(f'<robot name="two_arms">{inner}</robot>', "SRDF", TREE)


def srdf_refusal(inner: str) -> str:
    with pytest.raises(DescriptionError) as refused:
        read(inner)
    return str(refused.value)


def test_a_group_has_its_joints_from_the_root_to_the_last_link() -> None:
    for inner, joints, tip in (
        ('<joint name="r_elbow"/><joint name="r_shoulder"/>', ("r_shoulder", "r_elbow"), "r2"),
        ('<link name="l1"/><link name="l2"/><link name="l_tool"/>', ("l_shoulder", "l_elbow"), "l_tool"),
        ('<link name="base"/><link name="torso"/>', ("lift",), "torso"),
        ('<chain base_link="torso" tip_link="l2"/><chain base_link="torso" tip_link="r2"/>', BOTH, ""),
        (
            '<joint name="l_elbow"/><joint name="l_elbow"/><chain base_link="base" tip_link="l_tool"/>',
            ("lift", "l_shoulder", "l_elbow"),
            "l_tool",
        ),
    ):
        group = read(f'<group name="g">{inner}</group>').groups["g"]
        assert (group.joints, group.tip_link) == (joints, tip)


def test_nested_groups_bring_their_joints_in_any_order_and_a_chain_may_lead_from_one_branch_to_another() -> None:
    both = '<group name="both"><group name="left"/><group name="right"/></group>'
    for inner in (f"{both}{LEFT}{RIGHT}", f"{LEFT}{RIGHT}{both}"):
        group = read(inner).groups["both"]
        # Two arms have no tip.
        assert (group.joints, group.tip_link) == (BOTH, "")
    assert read(RIGHT).groups["right"].base_link == "torso"
    group = read('<group name="g"><chain base_link="l2" tip_link="r2"/></group>').groups["g"]
    assert (set(group.joints), group.tip_link) == (set(BOTH), "r2")


def test_a_joint_that_mimics_is_in_no_group_and_no_state_and_a_passive_joint_in_no_group() -> None:
    fingers = '<group name="hand"><joint name="grip"/><joint name="thumb"/></group>'
    values = '<joint name="grip" value="1"/><joint name="thumb" value="1"/>'
    semantics = read(f'{fingers}<group_state name="open" group="hand">{values}</group_state>')
    assert semantics.groups["hand"].joints == ("grip",)
    assert semantics.named_states == {"hand": {"open": {"grip": 1.0}}}
    semantics = read(f'{RIGHT}<passive_joint name="r_elbow"/>')
    assert semantics.groups["right"].joints == ("r_shoulder",)
    assert (semantics.passive_joints, semantics.planning_frame) == ({"r_elbow"}, "base")


VIRTUAL = '<virtual_joint name="world_joint" type="planar" parent_frame="odom" child_link="base"/>'


def test_a_virtual_joint_names_the_planning_frame_and_is_no_joint_of_a_group() -> None:
    semantics = read(
        f'{VIRTUAL}<group name="wheels"><joint name="world_joint"/></group>'
        f'<group name="all"><group name="wheels"/><group name="left"/></group>{LEFT}<passive_joint name="world_joint"/>'
        '<group_state name="s" group="all"><joint name="world_joint" value="0 0 0"/><joint name="l_elbow" value="1"/>'
        "</group_state>"
    )
    assert semantics.planning_frame == "odom"
    assert set(semantics.groups) == {"all", "left"}
    assert semantics.named_states == {"all": {"s": {"l_elbow": 1.0}}}


def test_an_end_effector_that_names_the_arm_itself_names_its_tip_and_one_of_its_own_group_none() -> None:
    arm = '<group name="arm"><joint name="l_shoulder"/><joint name="l_elbow"/></group>'
    effector = '<end_effector name="hand" parent_link="l_tool" group="arm"/>'
    assert read(arm).groups["arm"].tip_link == "l2"
    assert read(arm + effector).groups["arm"].tip_link == "l_tool"
    hand = '<group name="hand"><joint name="grip"/></group>'
    semantics = read(f'{RIGHT}{hand}<end_effector name="e" parent_link="r2" group="hand"/>')
    assert semantics.groups["hand"].tip_link == "jaw"
    assert [effector.parent_link for effector in semantics.end_effectors] == ["r2"]


def test_a_state_without_a_group_is_one_of_the_smallest_and_links_are_checked_by_default_or_where_enabled() -> None:
    everything = '<group name="all"><chain base_link="base" tip_link="l2"/></group>'
    semantics = read(
        f'{everything}{LEFT}<group_state name="up"><joint name="l_elbow" value="1"/></group_state>'
        '<disable_default_collisions link="jaw"/><enable_collisions link1="jaw" link2="base"/>'
        '<disable_collisions link1="l1" link2="gone"/>'
    )
    assert semantics.named_states == {"left": {"up": {"l_elbow": 1.0}}}
    assert frozenset(("jaw", "l1")) in semantics.disabled_pairs
    assert frozenset(("jaw", "base")) not in semantics.disabled_pairs


BROKEN_SRDF = {
    "nothing moves": (
        '<group name="g"><joint name="l_mount"/></group>',
        'no <group> with a movable joint of the URDF: add <group name="arm"><chain base_link="base" tip_link="jaw"/>',
    ),
    "unknown joint": ('<group name="g"><joint name="q"/></group>', "group 'g' <joint> names the joint 'q'"),
    "unknown link": ('<group name="g"><link name="q"/></group>', "group 'g' <link> names the link 'q'"),
    "unknown base": ('<group name="g"><chain base_link="q" tip_link="l1"/></group>', "<chain> names the link 'q'"),
    "unknown group": ('<group name="g"><group name="q"/></group>', "the group 'q', which does not exist"),
    "ring of groups": (
        '<group name="a"><group name="b"/></group><group name="b"><group name="a"/></group>',
        "contains itself: a -> b -> a",
    ),
    "groups within each other": (
        "".join(f'<group name="g{n}"><group name="g{n + 1}"/></group>' for n in range(3000)) + '<group name="g3000"/>',
        "group 'g21' is nested in more than 20 groups",
    ),
    "effector's group": (f'{LEFT}<end_effector name="e" group="q" parent_link="l1"/>', "the group 'q'"),
    "effector's link": (f'{LEFT}<end_effector name="e" group="left" parent_link="q"/>', "'e' names the link 'q'"),
    "joint of a state": (
        f'{LEFT}<group_state name="s" group="left"><joint name="q" value="1"/></group_state>',
        "group_state 's' <joint> names the joint 'q'",
    ),
    "state of no group": (
        f'{LEFT}<group_state name="s"><joint name="grip" value="1"/></group_state>',
        "group_state 's' has no attribute 'group'",
    ),
    "passive joint": (f'{LEFT}<passive_joint name="q"/>', "<passive_joint> names the joint 'q'"),
}


@pytest.mark.parametrize(("inner", "words"), BROKEN_SRDF.values(), ids=BROKEN_SRDF)
def test_a_broken_srdf_is_refused_with_its_element(inner: str, words: str) -> None:
    assert words in srdf_refusal(inner)


def test_the_srdf_of_another_robot_is_refused_with_both_names() -> None:
    with pytest.raises(DescriptionError, match=r"the URDF of 'two_arms' does not have.*is of the robot 'panda'"):
        read_srdf('<robot name="panda"><group name="arm"><joint name="j1"/></group></robot>', "SRDF panda.srdf", TREE)
