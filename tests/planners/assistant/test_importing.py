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

QUICK = 20


def silent(_line: str) -> None:
    pass


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
    assert arm.named_states["arm"]["home"] == {"turn": 0.0, "lift": 0.0, "bend": 0.0, "roll": 1.75}
    collision = CollisionModel(arm)
    home = {**dict.fromkeys(collision.joint_names, 0.0), **arm.named_states["arm"]["home"]}
    assert not collision.in_collision(np.array([home[name] for name in collision.joint_names]))


def test_every_link_with_a_shape_has_parts_and_a_hull_that_encloses_them(imported):
    arm = robot_folder.load(imported[0]).model
    assert set(arm.hulls) == set(arm.parts) == {"base", "turret", "upper", "fore", "palm", "left", "right"}
    # Shapes are in the frames of the links.
    assert arm.parts["palm"][0].max(axis=0) == pytest.approx([0.015, 0.04, 0.03])
    for link, parts in arm.parts.items():
        hull = arm.hulls[link]
        for vertices in parts:
            assert vertices.min(axis=0) == pytest.approx(np.maximum(vertices.min(axis=0), hull.vertices.min(axis=0)))
            assert vertices.max(axis=0) == pytest.approx(np.minimum(vertices.max(axis=0), hull.vertices.max(axis=0)))


def test_the_folder_can_be_moved(imported, urdf, tmp_path):
    moved = tmp_path / "moved"
    shutil.copytree(imported[0], moved)
    root = ET.parse(next(moved.glob("*.urdf"))).getroot()
    names = {mesh.get("filename") for mesh in root.iter("mesh")}
    assert names == {"meshes/base.stl", "meshes/turret.stl", "meshes/channel.stl"}
    assert all((moved / name).is_file() for name in names)


def test_the_picture_shows_something_in_each_view(imported):
    with Image.open(imported[0] / "parts.png") as image:
        pixels = np.asarray(image.convert("L"))
    half_y, half_x = (length // 2 for length in pixels.shape)
    for rows in (pixels[:half_y], pixels[half_y:]):
        for view in (rows[:, :half_x], rows[:, half_x:]):
            assert np.count_nonzero(view < 250) > 5000


def test_progress_names_each_link_and_how_far_its_parts_are(imported):
    told = "\n".join(imported[2])
    assert "link 3 of 7, upper: " in told
    assert "mm from the mesh" in told
    assert "600 of 600 states" in told
    assert any(line.startswith("checked: loads, and a motion of") for line in imported[1])


def test_the_same_seed_makes_the_same_folder(urdf, tmp_path):
    for name in ("first", "again"):
        import_robot(ImportOptions(urdf, tmp_path / name / "arm", samples=QUICK, convex=False), silent)
    assert files(tmp_path / "first") == files(tmp_path / "again")
    # Without convex parts the meshes are checked.
    arm = robot_folder.load(tmp_path / "again" / "arm").model
    assert arm.parts == arm.hulls == {}
    assert "<mesh" in arm.urdf


def test_only_a_robot_folder_is_overwritten_and_only_when_asked(urdf, tmp_path):
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "thesis.txt").write_text("irreplaceable")
    with pytest.raises(AssistantError, match="is there already: give another folder by --out, or --overwrite"):
        import_robot(ImportOptions(urdf, tmp_path / "arm", samples=QUICK), silent)
    with pytest.raises(AssistantError, match=r"has no robot\.toml, so it is no robot folder"):
        import_robot(ImportOptions(urdf, tmp_path / "arm", samples=QUICK, overwrite=True), silent)
    assert (tmp_path / "arm" / "thesis.txt").read_text() == "irreplaceable"


def test_a_robot_folder_is_overwritten_when_asked(urdf, tmp_path):
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "robot.toml").write_text("# old")
    import_robot(ImportOptions(urdf, tmp_path / "arm", samples=QUICK, convex=False, overwrite=True), silent)
    assert "CHECK" in (tmp_path / "arm" / "robot.toml").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["arm"]


def test_an_interrupted_import_leaves_nothing(urdf, tmp_path):
    def interrupt(line: str) -> None:
        if line.startswith("drawing"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_robot(ImportOptions(urdf, tmp_path / "arm", samples=QUICK, convex=False), interrupt)
    assert list(tmp_path.iterdir()) == []


def test_a_mesh_that_is_not_there_is_named_with_the_paths_tried(tmp_path):
    urdf = write_package(tmp_path)
    (tmp_path / "mesh_arm" / "meshes" / "channel.stl").unlink()
    with pytest.raises(DescriptionError, match=r"package://mesh_arm/meshes/channel\.stl.*tried: .*channel\.stl"):
        import_robot(ImportOptions(urdf, tmp_path / "out", samples=QUICK), silent)
    assert not (tmp_path / "out").exists()


def test_a_link_that_is_only_seen_is_mentioned(tmp_path):
    urdf = write_package(tmp_path)
    urdf.write_text(
        urdf.read_text().replace(
            '<link name="tool_point"/>',
            '<link name="tool_point"><visual><geometry><sphere radius="0.01"/></geometry></visual></link>',
        )
    )
    lines = import_robot(ImportOptions(urdf, tmp_path / "out", samples=QUICK, convex=False), silent)
    assert any(line.startswith("CHECK: tool_point: these links are seen but have no <collision>") for line in lines)


def test_what_cannot_be_imported_is_refused(urdf, tmp_path):
    assert default_folder(urdf) == Path("mesh_arm")
    with pytest.raises(AssistantError, match="--samples 0: must be from 1 to 1000000"):
        import_robot(ImportOptions(urdf, tmp_path / "arm", samples=0), silent)


XACRO = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'


@pytest.mark.parametrize(
    ("text", "next_step"),
    [
        ("<sdf/>", "must start with <robot>, not <sdf>"),
        ('<mujoco model="arm"/>', "is MJCF, MuJoCo's format: convert it to a URDF first"),
        (XACRO.format('<xacro:include filename="arm.xacro"/>'), "<xacro:include>: expand it first with `xacro"),
        (
            XACRO.format('<link name="${side}_hand"/>'),
            'is xacro, with name="${side}_hand": expand it first with `xacro',
        ),
    ],
)
def test_a_file_of_another_format_is_refused_by_its_name_with_the_next_step(tmp_path, text, next_step):
    (tmp_path / "a.urdf").write_text(text)
    with pytest.raises(DescriptionError, match=f"{tmp_path / 'a.urdf'} .*{re.escape(next_step)}"):
        import_robot(ImportOptions(tmp_path / "a.urdf", tmp_path / "out"), silent)
