import pytest

from robot.description.srdf import Semantics, read_srdf
from robot.description.urdf import read_urdf
from robot.errors import DescriptionError

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


def refusal(inner: str) -> str:
    with pytest.raises(DescriptionError) as refused:
        read(inner)
    return str(refused.value)


@pytest.mark.parametrize(
    ("inner", "joints", "tip"),
    [
        ('<joint name="r_elbow"/><joint name="r_shoulder"/>', ("r_shoulder", "r_elbow"), "r2"),
        ('<link name="l1"/><link name="l2"/><link name="l_tool"/>', ("l_shoulder", "l_elbow"), "l_tool"),
        ('<link name="base"/><link name="torso"/>', ("lift",), "torso"),
        ('<chain base_link="torso" tip_link="l2"/><chain base_link="torso" tip_link="r2"/>', BOTH, ""),
        (
            '<joint name="l_elbow"/><joint name="l_elbow"/><chain base_link="base" tip_link="l_tool"/>',
            ("lift", "l_shoulder", "l_elbow"),
            "l_tool",
        ),
    ],
)
def test_a_group_has_its_joints_from_the_root_to_the_last_link(inner: str, joints: tuple[str, ...], tip: str) -> None:
    group = read(f'<group name="g">{inner}</group>').groups["g"]
    assert (group.joints, group.tip_link) == (joints, tip)


def test_nested_groups_bring_their_joints_whatever_their_order_in_the_file_and_two_arms_have_no_tip() -> None:
    both = '<group name="both"><group name="left"/><group name="right"/></group>'
    for inner in (f"{both}{LEFT}{RIGHT}", f"{LEFT}{RIGHT}{both}"):
        group = read(inner).groups["both"]
        assert group.joints == BOTH
        assert group.tip_link == ""
    assert read(RIGHT).groups["right"].base_link == "torso"


def test_a_chain_may_lead_from_one_branch_to_another() -> None:
    group = read('<group name="g"><chain base_link="l2" tip_link="r2"/></group>').groups["g"]
    assert set(group.joints) == set(BOTH)
    assert group.tip_link == "r2"


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


def test_a_state_without_a_group_is_one_of_the_smallest_group_with_its_joints() -> None:
    everything = '<group name="all"><chain base_link="base" tip_link="l2"/></group>'
    state = '<group_state name="up"><joint name="l_elbow" value="1"/></group_state>'
    assert read(everything + LEFT + state).named_states == {"left": {"up": {"l_elbow": 1.0}}}


def test_links_without_default_collisions_are_checked_only_where_enabled() -> None:
    semantics = read(
        f'{LEFT}<disable_default_collisions link="jaw"/><enable_collisions link1="jaw" link2="base"/>'
        '<disable_collisions link1="l1" link2="gone"/>'
    )
    assert frozenset(("jaw", "l1")) in semantics.disabled_pairs
    assert frozenset(("jaw", "base")) not in semantics.disabled_pairs


BROKEN = {
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


@pytest.mark.parametrize(("inner", "words"), BROKEN.values(), ids=BROKEN)
def test_a_broken_srdf_is_refused_with_its_element(inner: str, words: str) -> None:
    assert words in refusal(inner)


def test_the_srdf_of_another_robot_is_refused_with_both_names() -> None:
    with pytest.raises(DescriptionError) as refused:
        read_srdf('<robot name="panda"><group name="arm"><joint name="j1"/></group></robot>', "SRDF panda.srdf", TREE)
    assert str(refused.value) == (
        "SRDF panda.srdf group 'arm' <joint> names the joint 'j1', which the URDF of 'two_arms' does not have: correct "
        "the name, or give the SRDF that belongs to this URDF (this one is of the robot 'panda')"
    )
