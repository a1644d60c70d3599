import math

import pytest

from robot.description.urdf import Joint, JointLimits, Mimic, read_urdf
from robot.errors import DescriptionError

PALM = '<robot name="hand"><link name="palm"/><link name="left"/><link name="right"/><link name="tip"/>'
LEFT = """<joint name="grip" type="prismatic"><parent link="palm"/><child link="left"/>
<limit lower="0" upper="0.04" velocity="0.2" effort="1"/></joint>"""
RIGHT = """<joint name="other" type="prismatic"><parent link="palm"/><child link="right"/>
<mimic joint="grip" multiplier="-1" offset="0.01"/></joint>"""
TIP = """<joint name="last" type="revolute"><parent link="right"/><child link="tip"/>
<mimic joint="other" multiplier="2" offset="0.5"/></joint></robot>"""
HAND = PALM + LEFT + RIGHT + TIP


def tree(text: str, limits: dict[str, JointLimits] | None = None):
    return read_urdf(text, "URDF", limits or {})


def refusal(text: str) -> str:
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


def test_limits_from_beside_the_urdf_replace_its_own() -> None:
    joint = tree(
        HAND.replace('velocity="0.2"', 'velocity="0"'),
        {"grip": JointLimits(max_velocity=0.1, max_acceleration=0.3, max_jerk=3.0)},
    ).joints["grip"]
    assert (joint.max_velocity, joint.max_acceleration, joint.max_jerk) == (0.1, 0.3, 3.0)


def test_a_continuous_joint_needs_no_limit_element_where_its_velocity_is_given() -> None:
    text = HAND.replace('type="prismatic"', 'type="continuous"', 1)
    text = text.replace('<limit lower="0" upper="0.04" velocity="0.2" effort="1"/>', "")
    joint = tree(text, {"grip": JointLimits(max_velocity=1.0)}).joints["grip"]
    assert (joint.lower, joint.upper) == (-math.pi, math.pi)
    assert "[joints.grip]" in refusal(text)


def test_a_floating_joint_rests() -> None:
    base = '<joint name="base" type="floating"><parent link="world"/><child link="palm"/></joint>'
    assert not tree(HAND.replace("</robot>", f'<link name="world"/>{base}</robot>')).joints["base"].movable


def test_the_namespace_of_xacro_alone_is_no_xacro() -> None:
    tree(HAND.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" '))


BROKEN = {
    "velocity zero": (HAND.replace('"0.2"', '"0"'), "not 0: correct it, or set max_velocity in [joints.grip] of robot"),
    "no velocity": (HAND.replace(' velocity="0.2"', ""), "max_velocity in [joints.grip] of robot.toml"),
    "unknown leader": (HAND.replace('mimic joint="grip"', 'mimic joint="grap"'), "names the joint 'grap'"),
    "ring of mimics": (HAND.replace('mimic joint="grip"', 'mimic joint="last"'), "leads back to the joint itself"),
    "two of a name": (HAND.replace('name="other"', 'name="grip"'), "two joints of the name 'grip'"),
    "two parents": (HAND.replace('<child link="tip"/>', '<child link="left"/>'), "'left' is the child of two joints"),
    "unknown type": (HAND.replace('type="revolute"', 'type="hinge"'), "unknown type 'hinge'"),
    "ring of links": (HAND.replace('<parent link="right"/>', '<parent link="tip"/>'), "to one another in a ring"),
}


@pytest.mark.parametrize(("text", "words"), BROKEN.values(), ids=BROKEN)
def test_a_broken_urdf_is_refused_with_its_element(text: str, words: str) -> None:
    assert words in refusal(text)


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
