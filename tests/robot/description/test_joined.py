import itertools
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.joined import ALL_ARMS, BOTH_ARMS, PlacedArm, joined, prefixed, reach_m
from robot.description.meshes import find_mesh
from robot.description.model import RobotModel
from robot.description.urdf import Joint
from tests.helpers.robots import so101
from tests.helpers.stl_arm import write_package

ONE = so101()
LEFT, RIGHT = prefixed(ONE, "left"), prefixed(ONE, "right")


def pair(apart_m: float = 0.4) -> RobotModel:
    left, right = PlacedArm(LEFT, (0.0, apart_m, 0.0)), PlacedArm(RIGHT, base_rpy_rad=(0.0, 0.0, 1.0))
    return joined("pair", {"left": left, "right": right})


def limits(joint: Joint) -> tuple[float, ...]:
    return joint.lower, joint.upper, joint.max_velocity, joint.max_acceleration


def test_all_of_an_arm_begins_with_its_name_and_limits_states_hulls_and_unchecked_pairs_are_its_own() -> None:
    names = (*LEFT.links, *LEFT.joints, *LEFT.groups, LEFT.tip_link, LEFT.default_group)
    assert all(name.startswith("left_") for name in names)
    assert LEFT.gripper.joints == ("left_gripper",)
    whole = pair()
    names = [joint.name for joint in whole.movable_joints]
    assert names == [joint.name for arm in (LEFT, RIGHT) for joint in arm.movable_joints]
    for joint in ONE.movable_joints:
        assert limits(LEFT.joints[f"left_{joint.name}"]) == limits(joint)
    for kind in ("hulls", "parts", "surfaces"):
        assert getattr(LEFT, kind).keys() == {f"left_{link}" for link in getattr(ONE, kind)}
        assert getattr(whole, kind) == getattr(LEFT, kind) | getattr(RIGHT, kind)
    assert LEFT.disabled_pairs == {frozenset(f"left_{link}" for link in each) for each in ONE.disabled_pairs}
    for group, states in ONE.named_states.items():
        same = {name: {f"left_{joint}": at for joint, at in state.items()} for name, state in states.items()}
        assert LEFT.named_states[f"left_{group}"] == whole.named_states[f"left_{group}"] == same


def test_each_arm_stands_at_its_place() -> None:
    whole, alone = ForwardPlacements(pair()), ForwardPlacements(ONE)
    bent = {joint.name: 0.3 for joint in ONE.movable_joints}
    both = {f"{arm}_{name}": value for arm in ("left", "right") for name, value in bent.items()}
    tip = np.array(alone.transforms(bent)["gripper_frame_link"])
    placed = whole.transforms(both)
    shifted, turned = np.eye(4), np.eye(4)
    shifted[1, 3] = 0.4
    turned[:2, :2] = [[math.cos(1.0), -math.sin(1.0)], [math.sin(1.0), math.cos(1.0)]]
    assert np.allclose(placed["left_gripper_frame_link"], shifted @ tip)
    assert np.allclose(placed["right_gripper_frame_link"], turned @ tip)


def test_two_arms_have_a_group_of_both_with_the_states_that_both_have_and_more_arms_one_of_all() -> None:
    whole = pair()
    assert set(whole.groups[BOTH_ARMS].joints) == {*LEFT.groups["left_arm"].joints, *RIGHT.groups["right_arm"].joints}
    assert whole.named_states[BOTH_ARMS].keys() == ONE.named_states["arm"].keys()
    assert whole.groups[BOTH_ARMS].tip_link == ""
    three = joined("three", {name: PlacedArm(prefixed(ONE, name)) for name in ("a", "b", "c")})
    assert len(three.groups[ALL_ARMS].joints) == 15
    assert BOTH_ARMS not in three.groups


@pytest.mark.parametrize("apart_m", [0.4, 2.0])
def test_arms_are_checked_against_each_other_unless_they_cannot_meet(apart_m: float) -> None:
    between = {frozenset(each) for each in itertools.product(LEFT.links, RIGHT.links)}
    near = apart_m <= 2.0 * reach_m(ONE)
    assert bool(between & pair(apart_m).disabled_pairs) is not near
    assert near or between <= pair(apart_m).disabled_pairs


def test_no_part_of_an_arm_comes_beyond_its_reach() -> None:
    placements, reach = ForwardPlacements(ONE), reach_m(ONE)
    random = np.random.default_rng(7)
    for _ in range(200):
        positions = {joint.name: float(random.uniform(joint.lower, joint.upper)) for joint in ONE.movable_joints}
        for link, transform in placements.transforms(positions).items():
            vertices = ONE.hulls[link].vertices if link in ONE.hulls else np.zeros((1, 3))
            at = vertices @ np.array(transform)[:3, :3].T + np.array(transform)[:3, 3]
            assert np.linalg.norm(at, axis=1).max() <= reach


SRDF = '<robot name="Mesh Arm"><group name="arm"><chain base_link="base" tip_link="tool_point"/></group></robot>'


@pytest.mark.parametrize("place", ["package://mesh_arm/meshes", "../meshes"])
def test_meshes_are_found_from_the_description_of_all_and_their_reach_is_unknown(tmp_path: Path, place: str) -> None:
    urdf = write_package(tmp_path)
    urdf.write_text(urdf.read_text().replace("package://mesh_arm/meshes", place))
    (tmp_path / "arm.srdf").write_text(SRDF)
    robot = model.load(urdf, tmp_path / "arm.srdf", (tmp_path,))
    assert reach_m(robot) == math.inf
    whole = joined("two", {name: PlacedArm(prefixed(robot, name)) for name in ("left", "right")})
    names = {mesh.get("filename", "") for mesh in ET.fromstring(whole.urdf).iter("mesh")}
    found = {find_mesh(name, whole.mesh_directory, whole.package_directories).name for name in names}
    assert found == {"base.stl", "turret.stl", "channel.stl"}
