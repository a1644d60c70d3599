"""Imports of a robot: structure, surfaces, pairs of links and the whole."""

import re
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from planners.assistant.decomposition import Limits, Reference, decompose
from planners.assistant.draft import Tree, find_structure
from planners.assistant.importing import ImportOptions, default_folder, import_robot
from planners.assistant.link_shapes import link_shapes, link_surfaces, shapes_in_link
from planners.assistant.pairs import SelfContacts, UncheckedPair, free_state, unchecked_pairs
from planners.assistant.surface import ConvexPart, Surface, measure, merged
from planners.errors import AssistantError
from planners.geometry.collision import CollisionModel
from robot.description import model, robot_folder
from robot.errors import DescriptionError
from tests.helpers import robots
from tests.helpers.robots import SEVEN_JOINT_URDF
from tests.helpers.stl_arm import URDF, boxes_union, channel, write_package


def silent(_line: str) -> None:
    pass


def quickly(urdf: Path, out: Path, progress=silent, **options) -> list[str]:
    return import_robot(ImportOptions(urdf, out, **{"samples": 20, "convex": False, **options}), progress)


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_the_folder_loads_without_a_problem_and_can_be_moved(imported, tmp_path):
    out, _, _ = imported
    assert list(robot_folder.problems(str(out))) == []
    arm = robot_folder.load(out).model
    assert arm.groups["arm"].joints == ("turn", "lift", "bend", "roll")
    assert arm.tip_link == "tool_point"
    # The gripper opens where its fingers are apart; home is zero, or the middle of the range, and nothing touches.
    assert arm.gripper == model.GripperModel(("left_finger", "right_finger"), 0.03, 0.0)
    home = arm.named_states["arm"]["home"]
    assert home == {"turn": 0.0, "lift": 0.0, "bend": 0.0, "roll": 1.75}
    collision = CollisionModel(arm)
    assert not collision.in_collision(np.array([home.get(name, 0.0) for name in collision.joint_names]))
    moved = shutil.copytree(out, tmp_path / "moved")
    root = ET.parse(next(moved.glob("*.urdf"))).getroot()
    names = {mesh.get("filename") for mesh in root.iter("mesh")}
    assert names == {"meshes/base.stl", "meshes/turret.stl", "meshes/channel.stl"}
    assert all((moved / name).is_file() for name in names)


def test_every_link_with_a_shape_has_parts_and_a_hull_that_encloses_them(imported):
    arm = robot_folder.load(imported[0]).model
    assert set(arm.hulls) == set(arm.parts) == {"base", "turret", "upper", "fore", "palm", "left", "right"}
    # Shapes are in the frames of the links.
    assert arm.parts["palm"][0].max(axis=0) == pytest.approx([0.015, 0.04, 0.03])
    for link, parts in arm.parts.items():
        hull, vertices = arm.hulls[link].vertices, np.vstack(parts)
        assert np.all(vertices.min(axis=0) >= hull.min(axis=0) - 1e-6), link
        assert np.all(vertices.max(axis=0) <= hull.max(axis=0) + 1e-6), link


def test_the_picture_shows_something_in_each_view_and_progress_names_each_link_and_how_far_its_parts_are(imported):
    out, lines, progress = imported
    with Image.open(out / "parts.png") as image:
        pixels = np.asarray(image.convert("L"))
    half_y, half_x = (length // 2 for length in pixels.shape)
    for rows in (pixels[:half_y], pixels[half_y:]):
        for view in (rows[:, :half_x], rows[:, half_x:]):
            assert np.count_nonzero(view < 250) > 5000
    told = "\n".join(progress)
    assert all(words in told for words in ("link 3 of 7, upper: ", "mm from the mesh", "600 of 600 states"))
    assert any(line.startswith("checked: loads, and a motion of") for line in lines)


def test_the_same_seed_makes_the_same_folder(urdf, tmp_path):
    for name in ("first", "again"):
        quickly(urdf, tmp_path / name / "arm")
    assert files(tmp_path / "first") == files(tmp_path / "again")
    # Without convex parts the meshes are checked.
    arm = robot_folder.load(tmp_path / "again" / "arm").model
    assert arm.parts == arm.hulls == {}
    assert "<mesh" in arm.urdf


def test_only_a_robot_folder_is_overwritten_and_only_when_asked(urdf, tmp_path):
    out = tmp_path / "arm"
    out.mkdir()
    (out / "thesis.txt").write_text("irreplaceable")
    with pytest.raises(AssistantError, match="is there already: give another folder by --out, or --overwrite"):
        quickly(urdf, out)
    with pytest.raises(AssistantError, match=r"has no robot\.toml, so it is no robot folder"):
        quickly(urdf, out, overwrite=True)
    assert (out / "thesis.txt").read_text() == "irreplaceable"
    (out / "robot.toml").write_text("# old")
    quickly(urdf, out, overwrite=True)
    assert "CHECK" in (out / "robot.toml").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["arm"]


def test_an_interrupted_import_or_one_without_a_mesh_leaves_nothing_and_a_link_that_is_only_seen_is_mentioned(tmp_path):
    urdf = write_package(tmp_path)
    seen = '<visual><geometry><sphere radius="0.01"/></geometry></visual>'
    text = urdf.read_text().replace('<link name="tool_point"/>', f'<link name="tool_point">{seen}</link>')
    urdf.write_text(text)
    lines = quickly(urdf, tmp_path / "seen")
    assert any(line.startswith("CHECK: tool_point: these links are seen but have no <collision>") for line in lines)

    def interrupt(line: str) -> None:
        if line.startswith("drawing"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        quickly(urdf, tmp_path / "out", interrupt)
    (tmp_path / "mesh_arm" / "meshes" / "channel.stl").unlink()
    with pytest.raises(DescriptionError, match=r"package://mesh_arm/meshes/channel\.stl.*tried: .*channel\.stl"):
        quickly(urdf, tmp_path / "out", convex=True)
    assert {path.name for path in tmp_path.iterdir()} == {"mesh_arm", "seen"}


XACRO = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'
LEFT, EXPAND = '<link name="${side}_hand"/>', "expand it first with `xacro"


def test_what_cannot_be_imported_is_refused_by_its_name_with_the_next_step(urdf, tmp_path):
    assert default_folder(urdf) == Path("mesh_arm")
    with pytest.raises(AssistantError, match="--samples 0: must be from 1 to 1000000"):
        quickly(urdf, tmp_path / "arm", samples=0)
    path = tmp_path / "a.urdf"
    for text, next_step in (
        ("<sdf/>", "must start with <robot>, not <sdf>"),
        ('<mujoco model="arm"/>', "is MJCF, MuJoCo's format: convert it to a URDF first"),
        (XACRO.format('<xacro:include filename="arm.xacro"/>'), f"<xacro:include>: {EXPAND}"),
        (XACRO.format(LEFT), f'is xacro, with name="${{side}}_hand": {EXPAND}'),
    ):
        path.write_text(text)
        with pytest.raises(DescriptionError, match=f"{path} .*{re.escape(next_step)}"):
            import_robot(ImportOptions(path, tmp_path / "out"), silent)
    path.write_text(URDF.replace('"revolute"', '"hinge"').replace('"prismatic"', '"slider"'))
    with pytest.raises(AssistantError, match=f"{path} has no joint of a type that moves: revolute, "):
        quickly(path, tmp_path / "out")
    urdf.write_text(URDF.replace(' velocity="2"', "", 1))
    with pytest.raises(DescriptionError, match=f"URDF {urdf} joint 'turn' has no velocity limit"):
        quickly(urdf, tmp_path / "out")


def structure_of(urdf: str, base=None, tip=None):
    root = ET.fromstring(urdf)
    movable = (each for each in root.iterfind("joint") if each.get("type") != "fixed" and each.find("mimic") is None)
    joint = next(movable).get("name")
    arm = model.parse(urdf, f'<robot name="r"><group name="g"><joint name="{joint}"/></group></robot>')
    shaped = frozenset(link.get("name") for link in root.iterfind("link") if link.find("collision") is not None)
    return find_structure(Tree(arm.links, arm.joints), shaped, base, tip)


def test_two_fingers_one_jaw_or_none_are_the_gripper_and_the_tool_frame_is_the_tip():
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
    found = structure_of(SEVEN_JOINT_URDF)
    assert found.arm_joints == ("a1", "a2", "a3", "a4", "a5", "a6", "a7")
    assert (found.gripper_joints, found.tip_link) == ((), "tool")


def test_joints_before_the_base_given_are_held_the_tip_given_ends_the_arm_and_links_that_make_none_are_refused():
    found = structure_of(URDF, base="turret")
    assert (found.arm_joints, found.held_joints) == (("lift", "bend", "roll"), ("turn",))
    found = structure_of(URDF, tip="fore")
    assert (found.arm_joints, found.tip_link) == (("turn", "lift", "bend"), "fore")
    for base, tip, reason in (
        ("nowhere", None, "--base nowhere: .* palm"),
        (None, "nowhere", "--tip nowhere: .* palm"),
        ("fore", "turret", "no chain of joints leads from 'fore' to 'turret'"),
        (None, "turret", "has 1 movable joints"),
    ):
        with pytest.raises(AssistantError, match=reason):
            structure_of(URDF, base, tip)


def surface(triangles) -> Surface:
    return merged(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


CUBE = surface(boxes_union([((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1))]))


def test_a_part_too_small_leaves_the_surface_uncovered_faces_between_do_not_stand_out_and_planes_enclose_it():
    deviation = measure(CUBE, [ConvexPart(0.9 * CUBE.vertices_m)], np.random.default_rng(1))
    assert deviation.uncovered_m == pytest.approx(0.01, abs=0.0005)
    assert deviation.outside_m == 0.0
    halves = [((-0.1, -0.1, -0.1), (0.0, 0.1, 0.1)), ((0.0, -0.1, -0.1), (0.1, 0.1, 0.1))]
    parts = [ConvexPart(boxes_union([half]).reshape(-1, 3)) for half in halves]
    # Distances are to samples, which are 1.1 mm apart on this surface.
    assert measure(CUBE, parts, np.random.default_rng(1)).greatest_m < 0.002
    points, directions = (np.random.default_rng(0).normal(size=(count, 3)) for count in (400, 60))
    wider = ConvexPart(points).within(directions / np.linalg.norm(directions, axis=1)[:, np.newaxis])
    assert wider.depth_m(points).max() < 1e-9


def test_surfaces_of_the_builtin_arm_are_the_official_meshes(robot, shared_data) -> None:
    official = model.load(shared_data / "so101" / "so101_new_calib.urdf", robots.SO101.folder / "so101.srdf")
    expected = link_surfaces(official)
    with np.load(robot.surfaces["base_link"].path) as file:
        assert set(file.files) == expected.keys()
        assert all(np.array_equal(file[name], array) for name, array in expected.items())


def test_parts_cover_a_hollow_link_within_the_tolerance_leave_its_hollow_free_and_are_the_same_by_the_same_seed():
    found, again = (decompose(surface(channel()), Limits()) for _ in range(2))
    assert 1 < len(found.parts) <= 12
    assert found.deviation.greatest_m <= 0.003
    vertices, hollow = channel().reshape(-1, 3), np.array([[0.01, 0.0, 0.1]])
    assert np.min([part.depth_m(vertices) for part in found.parts], axis=0).max() < 1e-9
    assert min(part.depth_m(hollow).item() for part in found.parts) > 0.005
    for first, second in zip(found.parts, again.parts, strict=True):
        np.testing.assert_array_equal(first.vertices_m, second.vertices_m)


def test_a_convex_mesh_is_one_part_and_bounds_give_the_closest_parts_and_their_deviation():
    found = decompose(CUBE, Limits())
    assert len(found.parts) == 1
    assert found.deviation.greatest_m < 0.003
    assert len(decompose(surface(channel()), Limits(max_time_s=0.0)).parts) == 1
    found = decompose(surface(channel()), Limits(max_parts=1))
    assert len(found.parts) == 1
    assert found.deviation.outside_m == pytest.approx(0.016, abs=0.0005)


def test_parts_that_stand_out_as_far_as_each_other_are_cut_one_after_the_other(monkeypatch) -> None:
    monkeypatch.setattr(Reference, "stands_out_m", lambda *_: 1.0)
    assert len(decompose(surface(channel()), Limits(max_parts=6)).parts) > 1


# A post; a bar that turns beside it at half its reach; a flag fixed above the post that overlaps it; a far box.
PAIRS_URDF = """
<robot name="r">
  <link name="post"><collision><geometry><box size="0.1 0.1 0.2"/></geometry></collision></link>
  <link name="slider"/>
  <link name="flag"><collision><geometry><box size="0.2 0.02 0.02"/></geometry></collision></link>
  <link name="bar"><collision><geometry><box size="0.3 0.02 0.02"/></geometry></collision></link>
  <link name="far">
    <collision><origin xyz="0.5 0 0"/><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>
  <joint name="up" type="prismatic"><parent link="post"/><child link="slider"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.01" velocity="1" effort="1"/></joint>
  <joint name="side" type="fixed"><parent link="slider"/><child link="flag"/></joint>
  <joint name="swing" type="revolute"><parent link="flag"/><child link="bar"/><origin xyz="0 0.1 0"/><axis xyz="0 0 1"/>
    <limit lower="-1.5" upper="1.5" velocity="1" effort="1"/></joint>
  <joint name="out" type="revolute"><parent link="bar"/><child link="far"/><axis xyz="0 0 1"/>
    <limit lower="-0.1" upper="0.1" velocity="1" effort="1"/></joint>
</robot>
"""


def contacts_of(urdf):
    robot = model.parse(urdf, '<robot name="r"><group name="g"><joint name="up"/><joint name="swing"/></group></robot>')
    return SelfContacts(robot, {link: shapes_in_link(link, shapes) for link, shapes in link_shapes(robot).items()})


def test_links_are_adjacent_touch_never_or_always_and_those_that_touch_in_some_states_are_checked():
    contacts = contacts_of(PAIRS_URDF)
    found = unchecked_pairs(contacts, 400, 0, lambda _done: None)
    # Links without a shape are skipped: those before and behind them are adjacent.
    adjacent = {(pair.first, pair.second) for pair in found if pair.reason == "Adjacent"}
    assert adjacent == {("flag", "post"), ("bar", "flag"), ("bar", "far")}
    assert UncheckedPair("post", "far", "Never") in found
    assert frozenset(("post", "bar")) not in {frozenset((pair.first, pair.second)) for pair in found}
    # A free state is drawn where none is given.
    state, is_free = free_state(contacts, found, (np.array([0.0, 1.5, 0.0]),), 200, 0)
    assert is_free
    assert not contacts.touching(state, [("post", "bar")])
    inside = contacts_of(PAIRS_URDF.replace('<origin xyz="0 0.1 0"/>', '<origin xyz="0 0 0"/>'))
    assert UncheckedPair("post", "bar", "Always") in unchecked_pairs(inside, 50, 0, lambda _done: None)
