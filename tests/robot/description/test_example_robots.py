from __future__ import annotations

from importlib import metadata
from pathlib import Path

import pytest

from robot.description import model, robot_folder
from robot.description.model import RobotModel
from robot.description.robot_folder import PACKAGE, _robots, _urdfs, find_example
from robot.errors import DescriptionError

# Of the arms, those whose files lack something, and the sentence about it.
LACKING = {
    "z1": "z1.srdf group 'end_effector' <chain> names the link 'base', which the URDF of 'z1_description' does not",
}

# Planning group, its joints and its tip.
ARMS = {
    "panda": ("arm", 7, "panda_hand_tcp"),
    "xarm7": ("xarm7", 7, "link_eef"),
    "kinova": ("end_effector", 6, "j2s6s200_end_effector"),
    "pr2": ("right_arm_and_torso", 8, "r_wrist_roll_link"),
    # Their SRDF has no group.
    "ur5": ("arm", 6, "wrist_3_link"),
    "ur3_gripper": ("arm", 6, "wrist_3_link"),
    "talos": ("l_arm", 7, "wrist_left_ft_tool_link"),
}


def installed() -> bool:
    try:
        metadata.distribution(PACKAGE)
    except metadata.PackageNotFoundError:
        return False
    return True


needs_package = pytest.mark.skipif(not installed(), reason=f"{PACKAGE} is not installed (pip install {PACKAGE})")


def read(name: str) -> RobotModel:
    example = find_example(name)
    return model.load(example.urdf, example.srdf, package_directories=example.packages)


def robot_or_refusal(name: str) -> RobotModel | str:
    try:
        return read(name)
    except DescriptionError as refusal:
        return str(refusal)


@needs_package
@pytest.mark.parametrize("name", ARMS)
def test_a_published_arm_is_read_as_it_is(name: str) -> None:
    group, joints, tip = ARMS[name]
    found = read(name).groups[group]
    assert (len(found.joints), found.tip_link) == (joints, tip)


@needs_package
@pytest.mark.parametrize(("name", "words"), LACKING.items())
def test_a_published_arm_that_lacks_something_is_refused_with_its_file_and_element(name: str, words: str) -> None:
    with pytest.raises(DescriptionError) as refused:
        read(name)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


@needs_package
@pytest.mark.parametrize("name", sorted(_urdfs(_robots() or Path())))
def test_every_published_robot_is_read_or_refused_in_a_sentence(name: str) -> None:
    robot = robot_or_refusal(name)
    if isinstance(robot, str):
        assert robot.startswith(("URDF /", "SRDF /", PACKAGE))
        return
    for group in robot.groups.values():
        assert group.joints
        assert {robot.joints[joint].movable for joint in group.joints} == {True}
        assert group.tip_link == "" or group.tip_link in robot.links


@needs_package
def test_a_robot_without_srdf_is_refused_with_the_place_where_one_is_missed() -> None:
    with pytest.raises(DescriptionError, match=r"'ur10' has no SRDF"):
        find_example("ur10")


@needs_package
def test_a_published_robot_is_loaded_by_its_name_with_ideal_joints() -> None:
    found = robot_folder.resolve("panda")
    assert found.model.gripper == model.Gripper(("panda_finger_joint1",), 0.04, 0.0)
    assert found.hardware.kind == "ideal"


def test_a_name_that_the_package_does_not_have_is_not_found() -> None:
    assert find_example("no such robot") is None


def test_without_the_package_no_robot_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> metadata.Distribution:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", missing)
    assert find_example("panda") is None
