from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from robot.errors import DescriptionError
from tests.helpers.resources import shared_data
from tests.helpers.robots import so101

URDF = """<robot name="two"><link name="a"/><link name="b"/><link name="c"/>
<joint name="ab" type="revolute"><parent link="a"/><child link="b"/><limit lower="-1" upper="2" velocity="3"/></joint>
<joint name="bc" type="continuous"><parent link="b"/><child link="c"/><limit velocity="1"/></joint></robot>"""
SRDF = """<robot name="two"><group name="g"><chain base_link="a" tip_link="c"/></group>
<group_state name="up" group="g"><joint name="ab" value="1"/></group_state>
<disable_collisions link1="a" link2="b"/></robot>"""


def test_the_builtin_arm_has_its_joints_in_order_with_limits_of_the_servos() -> None:
    robot = so101()
    assert robot.groups["arm"].joints == ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
    assert [joint.name for joint in robot.movable_joints] == [*robot.groups["arm"].joints, "gripper"]
    assert robot.root_link == "base_link"
    assert robot.groups["arm"].tip_link == "gripper_frame_link"
    for joint in robot.movable_joints:
        assert joint.lower < joint.upper
        assert 0.0 < joint.max_velocity < 5.0
        assert 0.0 < joint.max_acceleration < 20.0


def test_every_link_with_a_shape_has_a_hull_whose_triangles_exist() -> None:
    robot = so101()
    shaped = {
        link.get("name") for link in ET.fromstring(robot.urdf).iterfind("link") if link.find("collision") is not None
    }
    assert set(robot.hulls) == shaped
    for hull in robot.hulls.values():
        assert hull.vertices.shape[1] == hull.triangles.shape[1] == 3
        assert hull.triangles.min() >= 0
        assert hull.triangles.max() < len(hull.vertices)


def test_the_builtin_figures_are_those_of_the_facts() -> None:
    facts = json.loads((shared_data() / "so101_facts.json").read_text())
    robot = so101()
    urdf = ET.fromstring(robot.urdf)
    for name, fact in facts["so101_new_calib"]["joints"].items():
        element = next(joint for joint in urdf.iterfind("joint") if joint.get("name") == name)
        origin = element.find("origin")
        assert origin is not None
        assert floats(origin, "xyz") == pytest.approx(fact["origin_xyz"], abs=1e-9)
        assert floats(origin, "rpy") == pytest.approx(fact["origin_rpy"], abs=1e-5)
        if fact["type"] == "revolute":
            assert (robot.joints[name].lower, robot.joints[name].upper) == (fact["lower"], fact["upper"])
    for name, limits in facts["recommended_limits"]["table"].items():
        assert (robot.joints[name].max_velocity, robot.joints[name].max_acceleration) == (limits["v"], limits["a"])
    for name, fact in facts["so101_new_calib"]["links"].items():
        inertial = next(link for link in urdf.iterfind("link") if link.get("name") == name).find("inertial")
        if inertial is not None:
            assert floats(inertial.find("mass"), "value") == pytest.approx([fact["mass"]], rel=1e-4)


def floats(element: ET.Element | None, attribute: str) -> list[float]:
    return [float(text) for text in element.attrib[attribute].split()]


def test_another_robot_is_read_from_its_files(tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(URDF)
    (tmp_path / "two.srdf").write_text(SRDF)
    robot = model.load(tmp_path / "two.urdf", tmp_path / "two.srdf")
    assert robot.links == ("a", "b", "c")
    assert robot.groups["g"].joints == ("ab", "bc")
    assert robot.joints["bc"].upper == math.pi
    assert robot.named_states == {"g": {"up": {"ab": 1.0}}}
    assert robot.disabled_pairs == {frozenset("ab")}
    assert robot.mesh_directory == tmp_path


BROKEN = {
    "no XML": ("<robot", SRDF, "URDF is not XML"),
    "another root": ("<html/>", SRDF, "<html>"),
    "no limit": (URDF.replace('<limit lower="-1" upper="2" velocity="3"/>', ""), SRDF, "joint 'ab' has no <limit>"),
    "limits reversed": (URDF.replace('lower="-1"', 'lower="4"'), SRDF, "lower 4 must be below upper 2"),
    "limit not finite": (URDF.replace('lower="-1"', 'lower="nan"'), SRDF, "lower must be a finite number, not 'nan'"),
    "velocity zero": (URDF.replace('velocity="3"', 'velocity="0"'), SRDF, "velocity must be above 0, not 0"),
    "two roots": (URDF.replace('<link name="a"/>', '<link name="a"/><link name="z"/>'), SRDF, "exactly one root"),
    "link missing": (URDF.replace('<link name="b"/>', ""), SRDF, "'b', which does not exist"),
    "no chain": (
        URDF,
        SRDF.replace('base_link="a" tip_link="c"', 'base_link="c" tip_link="a"'),
        "'g': no chain leads from 'c' to 'a'",
    ),
}


@pytest.mark.parametrize(("urdf", "srdf", "words"), BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_description_is_refused_with_its_reason(urdf: str, srdf: str, words: str) -> None:
    with pytest.raises(DescriptionError) as refused:
        model.parse(urdf, srdf)
    assert words in str(refused.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"nothing\.urdf cannot be read"):
        model.load(tmp_path / "nothing.urdf", tmp_path / "nothing.srdf")


HAND_URDF = URDF.replace(
    "</robot>",
    '<link name="palm"/><link name="finger"/><link name="thumb"/>'
    '<joint name="mount" type="fixed"><parent link="c"/><child link="palm"/></joint>'
    '<joint name="grip" type="prismatic"><parent link="palm"/><child link="finger"/>'
    '<limit lower="0.001" upper="0.04" velocity="1"/></joint>'
    '<joint name="press" type="prismatic"><parent link="palm"/><child link="thumb"/>'
    '<limit lower="0.001" upper="0.04" velocity="1"/></joint></robot>',
)
ARM = '<group name="arm"><chain base_link="a" tip_link="c"/></group>'
HAND = '<group name="fingers"><joint name="grip"/></group>'
EFFECTOR = '<end_effector name="e" parent_link="c" group="fingers"/>'


def hand_of(*elements: str) -> model.RobotModel:
    return model.parse(HAND_URDF, f'<robot name="two">{"".join(elements)}</robot>')


def test_an_end_effector_of_one_joint_is_the_gripper_and_opens_to_its_limits() -> None:
    assert hand_of(ARM, HAND, EFFECTOR).gripper == model.Gripper(("grip",), 0.04, 0.001)


def test_named_states_say_where_a_gripper_is_open_and_closed() -> None:
    states = "".join(
        f'<group_state name="{name}" group="fingers"><joint name="grip" value="{value}"/></group_state>'
        for name, value in (("open", 0.03), ("close", 0.01))
    )
    assert hand_of(ARM, HAND, EFFECTOR, states).gripper == model.Gripper(("grip",), 0.03, 0.01)


def test_a_gripper_may_have_two_joints_that_move_alike() -> None:
    both = '<group name="fingers"><joint name="grip"/><joint name="press"/></group>'
    assert hand_of(ARM, both, EFFECTOR).gripper == model.Gripper(("grip", "press"), 0.04, 0.001)


def test_an_end_effector_that_is_the_arm_is_no_gripper_but_a_group_named_hand_is() -> None:
    effector = '<end_effector name="e" parent_link="palm" group="arm"/>'
    assert hand_of(ARM, effector).gripper is None
    assert hand_of(ARM, effector, HAND.replace("fingers", "hand")).gripper == model.Gripper(("grip",), 0.04, 0.001)


def test_a_passive_joint_is_held_where_it_is_least_turned() -> None:
    robot = hand_of(ARM, '<passive_joint name="grip"/><passive_joint name="ab"/>')
    assert {robot.joints["grip"].type, robot.joints["ab"].type} == {"fixed"}
    free = hand_of(ARM)
    rest = {joint.name: 0.0 for joint in free.movable_joints}
    before = ForwardPlacements(free).transforms({**rest, "grip": 0.001})
    after = ForwardPlacements(robot).transforms(dict.fromkeys(rest.keys() - {"grip", "ab"}, 0.0))
    for link, transform in before.items():
        assert after[link] == pytest.approx(transform, abs=1e-12)


def test_the_group_of_goals_is_the_arm_else_the_first_chain() -> None:
    pair = '<group name="pair"><joint name="grip"/><joint name="press"/></group>'
    assert hand_of(pair, HAND, ARM).default_group == "arm"
    assert hand_of(pair, ARM.replace('"arm"', '"lift"')).default_group == "lift"


def test_a_robot_without_a_group_gets_the_longest_chain_and_a_line_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    robot = model.parse(HAND_URDF, "<robot name='two'/>")
    assert (robot.default_group, robot.groups["arm"].tip_link) == ("arm", "finger")
    assert '<group name="arm">' in robot.srdf
    assert "has no <group>: the group 'arm' is the longest chain" in caplog.text
