import json
import logging
import math
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planners.geometry.kinematics import ForwardKinematics
from robot.calibration import Calibration
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.limits import END_STOP_MARGIN_RAD, FASTEST_TICKS_S, within_calibration
from robot.description.meshes import find_mesh, package_path, with_mesh_paths
from robot.errors import DescriptionError
from tests.helpers.resources import shared_data
from tests.helpers.robots import nominal_calibration, so101
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF, PALLETIZER_SRDF, PALLETIZER_URDF

URDF = """<robot name="two"><link name="a"/><link name="b"/><link name="c"/>
<joint name="ab" type="revolute"><parent link="a"/><child link="b"/><limit lower="-1" upper="2" velocity="3"/></joint>
<joint name="bc" type="continuous"><parent link="b"/><child link="c"/><limit velocity="1"/></joint></robot>"""
SRDF = """<robot name="two"><group name="g"><chain base_link="a" tip_link="c"/></group>
<group_state name="up" group="g"><joint name="ab" value="1"/></group_state>
<disable_collisions link1="a" link2="b"/></robot>"""


def test_every_link_with_a_shape_has_a_hull_whose_triangles_exist() -> None:
    robot = so101()
    links = ET.fromstring(robot.urdf).iterfind("link")
    assert set(robot.hulls) == {link.get("name") for link in links if link.find("collision") is not None}
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
        assert floats(origin, "xyz") == pytest.approx(fact["origin_xyz"], abs=1e-9)
        assert floats(origin, "rpy") == pytest.approx(fact["origin_rpy"], abs=1e-5)
        if fact["type"] == "revolute":
            assert (robot.joints[name].lower, robot.joints[name].upper) == (fact["lower"], fact["upper"])
    for name, limits in facts["recommended_limits"]["table"].items():
        assert (robot.joints[name].max_velocity, robot.joints[name].max_acceleration) == (limits["v"], limits["a"])
    for name, fact in facts["so101_new_calib"]["links"].items():
        inertial = next(link for link in urdf.iterfind("link") if link.get("name") == name).find("inertial")
        if inertial is not None:
            (mass_kg,) = floats(inertial.find("mass"), "value")
            assert mass_kg == pytest.approx(fact["mass"], rel=1e-4)


def floats(element: ET.Element | None, attribute: str) -> list[float]:
    return [float(text) for text in element.attrib[attribute].split()]


def test_another_robot_is_read_from_its_files_and_one_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(URDF)
    (tmp_path / "two.srdf").write_text(SRDF)
    robot = model.load(tmp_path / "two.urdf", tmp_path / "two.srdf")
    assert robot.links == ("a", "b", "c")
    assert robot.groups["g"].joints == ("ab", "bc")
    assert robot.joints["bc"].upper == math.pi
    assert robot.named_states == {"g": {"up": {"ab": 1.0}}}
    assert robot.disabled_pairs == {frozenset("ab")}
    assert robot.mesh_directory == tmp_path
    with pytest.raises(DescriptionError, match=r"nothing\.urdf cannot be read"):
        model.load(tmp_path / "nothing.urdf", tmp_path / "nothing.srdf")


BROKEN = {
    "no XML": ("<robot", SRDF, "URDF is not XML"),
    "another root": ("<html/>", SRDF, "<html>"),
    "no limit": (
        URDF.replace('<limit lower="-1" upper="2" velocity="3"/>', ""),
        SRDF,
        "joint 'ab' has no <limit>: add <limit ",
    ),
    "limits reversed": (URDF.replace('lower="-1"', 'lower="4"'), SRDF, "lower 4 must be below upper 2"),
    "limit not finite": (URDF.replace('lower="-1"', 'lower="nan"'), SRDF, "lower must be a finite number, not 'nan'"),
    "two roots": (URDF.replace('<link name="a"/>', '<link name="a"/><link name="z"/>'), SRDF, "exactly one root"),
    "link missing": (URDF.replace('<link name="b"/>', ""), SRDF, "'b', which does not exist"),
    "no chain": (URDF, SRDF.replace('"a" tip_link="c"', '"c" tip_link="a"'), "'g': no chain leads from 'c' to 'a'"),
}


def test_a_broken_description_is_refused_with_its_reason() -> None:
    for urdf, srdf, words in BROKEN.values():
        with pytest.raises(DescriptionError) as refused:
            model.parse(urdf, srdf)
        assert words in str(refused.value)


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


STATES = "".join(
    f'<group_state name="{name}" group="fingers"><joint name="grip" value="{value}"/></group_state>'
    for name, value in (("open", 0.03), ("close", 0.01))
)
ALIKE = '<group name="fingers"><joint name="grip"/><joint name="press"/></group>'
ARM_ITSELF = '<end_effector name="e" parent_link="palm" group="arm"/>'


def test_the_gripper_is_the_end_effector_or_a_group_named_hand() -> None:
    for elements, gripper in (
        ((HAND, EFFECTOR), model.GripperModel(("grip",), 0.04, 0.001)),
        # States say where a gripper is open and closed.
        ((HAND, EFFECTOR, STATES), model.GripperModel(("grip",), 0.03, 0.01)),
        ((ALIKE, EFFECTOR), model.GripperModel(("grip", "press"), 0.04, 0.001)),
        ((ARM_ITSELF,), None),
        ((ARM_ITSELF, HAND.replace("fingers", "hand")), model.GripperModel(("grip",), 0.04, 0.001)),
    ):
        assert hand_of(ARM, *elements).gripper == gripper


def test_a_passive_joint_is_held_where_it_is_least_turned() -> None:
    robot = hand_of(ARM, '<passive_joint name="grip"/><passive_joint name="ab"/>')
    assert {robot.joints["grip"].type, robot.joints["ab"].type} == {"fixed"}
    free = hand_of(ARM)
    rest = {joint.name: 0.0 for joint in free.movable_joints}
    before = ForwardPlacements(free).transforms({**rest, "grip": 0.001})
    after = ForwardPlacements(robot).transforms(dict.fromkeys(rest.keys() - {"grip", "ab"}, 0.0))
    for link, transform in before.items():
        assert after[link] == pytest.approx(transform, abs=1e-12)


def test_the_group_of_goals_is_the_arm_else_the_first_or_longest_chain(caplog: pytest.LogCaptureFixture) -> None:
    pair = '<group name="pair"><joint name="grip"/><joint name="press"/></group>'
    assert hand_of(pair, HAND, ARM).default_group == "arm"
    assert hand_of(pair, ARM.replace('"arm"', '"lift"')).default_group == "lift"
    robot = hand_of()
    assert (robot.default_group, robot.groups["arm"].tip_link) == ("arm", "finger")
    assert '<group name="arm">' in robot.srdf
    assert "has no <group>: the group 'arm' is the longest chain" in caplog.text


ARMS = {
    "so101": so101(),
    "crane": model.parse(CRANE_URDF, CRANE_SRDF),
    "mimics": model.parse(PALLETIZER_URDF, PALLETIZER_SRDF),
}


@pytest.fixture(params=ARMS)
def arm(request):
    return ARMS[request.param]


def test_every_link_is_where_pinocchio_has_it_and_stands_on_its_parent_or_the_root_link_on_nothing(arm):
    names, placements = [joint.name for joint in arm.movable_joints], ForwardPlacements(arm)
    kinematics, rng = ForwardKinematics(arm, names), np.random.default_rng(3)
    for _ in range(20):
        positions = {joint.name: rng.uniform(joint.lower, joint.upper) for joint in arm.movable_joints}
        kinematics.place(np.array([positions[name] for name in names]))
        placed = placements.transforms(positions)
        for link, transform in placed.items():
            assert transform == pytest.approx(kinematics.placement(link).homogeneous, abs=1e-9)
    for link in set(arm.links) - {arm.root_link}:
        parent, transform_link_to_parent = placements.joint_transform(link, positions)
        assert placed[parent] @ transform_link_to_parent == pytest.approx(placed[link], abs=1e-12)
    with pytest.raises(KeyError):
        placements.joint_transform(arm.root_link, {})


def test_limits_never_exceed_calibrated_ranges_nor_what_servos_follow(caplog: pytest.LogCaptureFixture) -> None:
    robot, (first, second, *others) = so101(), nominal_calibration().joints
    short = replace(second, range_min=1500, range_max=2500)
    joint = within_calibration(robot, Calibration((first, short, *others))).joints["shoulder_lift"]
    assert joint.lower == pytest.approx(short.lower_rad + END_STOP_MARGIN_RAD)
    assert joint.upper == pytest.approx(short.upper_rad - END_STOP_MARGIN_RAD)
    joints = {**robot.joints, "wrist_flex": replace(robot.joints["wrist_flex"], max_velocity=4.0)}
    narrowed = within_calibration(replace(robot, joints=joints), nominal_calibration()).joints["wrist_flex"]
    assert narrowed.max_velocity == pytest.approx(2.51, abs=0.01)
    assert abs(others[1].ticks_s_from_rad_s(narrowed.max_velocity)) < FASTEST_TICKS_S
    narrowed_line = "joint wrist_flex: its velocity limit of 4 rad/s is narrowed to 2.51 rad/s"
    assert caplog.messages == [f"{narrowed_line}, the most its servo can follow"]
    for calibrated, named in (
        (replace(first, range_min=2000, range_max=2010), "shoulder_pan"),
        (replace(first, servo=replace(first.servo, joint="knee")), "knee"),
    ):
        with pytest.raises(DescriptionError, match=named):
            within_calibration(robot, Calibration((calibrated, second, *others)))


MESH_SRDF = '<robot name="r"><group name="g"><chain base_link="a" tip_link="b"/></group></robot>'


def urdf(mesh: str, use: str = "collision") -> str:
    return (
        f'<robot name="r"><link name="a"/><link name="b"><{use}><geometry><mesh filename="{mesh}"/></geometry></{use}>'
        '</link><joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Package arm_description in the standard layout, with one mesh and a folder for URDFs."""
    folder = tmp_path / "src" / "arm_description"
    (folder / "meshes").mkdir(parents=True)
    (folder / "urdf").mkdir()
    (folder / "meshes" / "b.stl").touch()
    return folder


URL = "package://arm_description/meshes/b.stl"


def test_a_mesh_is_found_beside_the_urdf_by_url_or_in_a_package(package: Path, tmp_path: Path) -> None:
    other, elsewhere, mesh = package.parent / "cell" / "urdf", tmp_path / "elsewhere", package / "meshes" / "b.stl"
    other.mkdir(parents=True)
    for name, beside, given in (
        *(("../meshes/b.stl", package / "urdf", ()), (f"file://{mesh}", None, ()), (str(mesh), package, ())),
        *((URL, package / "urdf", ()), (URL, other, ())),
        *((URL, elsewhere, (package.parent,)), (URL, elsewhere, (package,))),
    ):
        assert find_mesh(name, beside, given) == mesh


def test_a_package_is_known_by_its_package_xml_and_a_given_folder_comes_first(package: Path, tmp_path: Path) -> None:
    checkout = package.rename(package.parent / "arm-main")
    (checkout / "package.xml").write_text("<package><name>arm_description</name></package>")
    assert find_mesh(URL, checkout / "urdf", ()) == checkout / "meshes" / "b.stl"
    given = tmp_path / "given" / "arm_description" / "meshes" / "b.stl"
    given.parent.mkdir(parents=True)
    given.touch()
    assert find_mesh(URL, checkout / "urdf", (tmp_path / "given",)) == given


def test_folders_given_and_of_the_environment_of_either_ros_are_those_of_the_robot(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    environment = {"ROS_PACKAGE_PATH": "/ws/src:/opt/share", "AMENT_PREFIX_PATH": "/opt/ros/humble"}
    assert package_path(environment) == (Path("/ws/src"), Path("/opt/share"), Path("/opt/ros/humble/share"))
    assert package_path({}) == ()
    (tmp_path / "r.urdf").write_text(urdf(URL))
    (tmp_path / "r.srdf").write_text(MESH_SRDF)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(package.parent))
    robot = model.load(tmp_path / "r.urdf", tmp_path / "r.srdf", (tmp_path,))
    assert robot.package_directories == (tmp_path, package.parent)


def test_a_mesh_that_is_not_there_is_refused_with_the_paths_tried_or_missed_in_the_log_if_it_is_only_seen(
    package: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(DescriptionError, match=rf"--package-path.*{tmp_path / 'gone' / 'b.stl'}"):
        find_mesh("package://gone/b.stl", None, (tmp_path,))
    (package / "urdf" / "r.urdf").write_text(urdf("../meshes/gone.stl"))
    (tmp_path / "r.srdf").write_text(MESH_SRDF)
    with pytest.raises(DescriptionError) as refused:
        model.load(package / "urdf" / "r.urdf", tmp_path / "r.srdf")
    for words in (str(package / "urdf" / "r.urdf"), "link 'b' <collision>", "gone.stl' is not there"):
        assert words in str(refused.value)
    with caplog.at_level(logging.WARNING):
        model.parse(urdf("gone.dae", "visual"), MESH_SRDF, mesh_directory=tmp_path)
    assert "gone.dae" in caplog.text
    # One that is there has its path for a name.
    text = with_mesh_paths(urdf("../meshes/b.stl"), package / "urdf", ())
    assert f'filename="{package / "meshes" / "b.stl"}"' in text


def test_a_mesh_that_takes_gigabytes_to_load_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "large.stl").open("wb") as file:
        file.truncate(50_000_001)
    with pytest.raises(DescriptionError, match=r"large\.stl has 50000001 bytes, 50000000 are allowed"):
        model.parse(urdf("large.stl"), MESH_SRDF, mesh_directory=tmp_path)
