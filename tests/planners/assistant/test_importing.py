import re
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from planners.assistant.importing import ImportOptions, default_folder, import_robot
from planners.errors import AssistantError
from planners.geometry.collision import CollisionModel
from robot.description import robot_folder
from robot.errors import DescriptionError
from tests.helpers.stl_arm import write_package


def silent(_line: str) -> None:
    pass


def quickly(urdf: Path, out: Path, progress=silent, **options) -> list[str]:
    return import_robot(ImportOptions(urdf, out, **{"samples": 20, "convex": False, **options}), progress)


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_the_folder_loads_without_a_problem(imported):
    out, _, _ = imported
    assert list(robot_folder.problems(str(out))) == []
    arm = robot_folder.load(out).model
    assert arm.groups["arm"].joints == ("turn", "lift", "bend", "roll")
    assert arm.tip_link == "tool_point"
    # The gripper opens where its fingers are apart; home is zero, or the middle of the range, and nothing touches.
    assert arm.gripper.joints == ("left_finger", "right_finger")
    assert (arm.gripper.open, arm.gripper.closed) == (0.03, 0.0)
    home = arm.named_states["arm"]["home"]
    assert home == {"turn": 0.0, "lift": 0.0, "bend": 0.0, "roll": 1.75}
    collision = CollisionModel(arm)
    assert not collision.in_collision(np.array([home.get(name, 0.0) for name in collision.joint_names]))


def test_every_link_with_a_shape_has_parts_and_a_hull_that_encloses_them(imported):
    arm = robot_folder.load(imported[0]).model
    assert set(arm.hulls) == set(arm.parts) == {"base", "turret", "upper", "fore", "palm", "left", "right"}
    # Shapes are in the frames of the links.
    assert arm.parts["palm"][0].max(axis=0) == pytest.approx([0.015, 0.04, 0.03])
    for link, parts in arm.parts.items():
        hull = arm.hulls[link].vertices
        for vertices in parts:
            assert np.all(vertices.min(axis=0) >= hull.min(axis=0) - 1e-6), link
            assert np.all(vertices.max(axis=0) <= hull.max(axis=0) + 1e-6), link


def test_the_folder_can_be_moved(imported, tmp_path):
    moved = shutil.copytree(imported[0], tmp_path / "moved")
    root = ET.parse(next(moved.glob("*.urdf"))).getroot()
    names = {mesh.get("filename") for mesh in root.iter("mesh")}
    assert names == {"meshes/base.stl", "meshes/turret.stl", "meshes/channel.stl"}
    assert all((moved / name).is_file() for name in names)


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


def test_an_interrupted_import_leaves_nothing(urdf, tmp_path):
    def interrupt(line: str) -> None:
        if line.startswith("drawing"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        quickly(urdf, tmp_path / "arm", interrupt)
    assert list(tmp_path.iterdir()) == []


def test_a_mesh_that_is_not_there_is_named_with_the_paths_tried(tmp_path):
    urdf = write_package(tmp_path)
    (tmp_path / "mesh_arm" / "meshes" / "channel.stl").unlink()
    with pytest.raises(DescriptionError, match=r"package://mesh_arm/meshes/channel\.stl.*tried: .*channel\.stl"):
        quickly(urdf, tmp_path / "out", convex=True)
    assert not (tmp_path / "out").exists()


def test_a_link_that_is_only_seen_is_mentioned(tmp_path):
    urdf = write_package(tmp_path)
    seen = '<visual><geometry><sphere radius="0.01"/></geometry></visual>'
    text = urdf.read_text().replace('<link name="tool_point"/>', f'<link name="tool_point">{seen}</link>')
    urdf.write_text(text)
    lines = quickly(urdf, tmp_path / "out")
    assert any(line.startswith("CHECK: tool_point: these links are seen but have no <collision>") for line in lines)


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
