from __future__ import annotations

import logging
from pathlib import Path

import pytest

from robot.description import model
from robot.description.mesh_files import find_mesh, package_path, with_mesh_paths
from robot.errors import DescriptionError

SRDF = '<robot name="r"><group name="g"><chain base_link="a" tip_link="b"/></group></robot>'


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


def test_a_relative_name_is_sought_beside_the_urdf_and_a_url_or_an_absolute_path_is_the_path(package: Path) -> None:
    mesh = package / "meshes" / "b.stl"
    assert find_mesh("../meshes/b.stl", package / "urdf", ()) == mesh
    assert find_mesh(f"file://{mesh}", None, ()) == mesh
    assert find_mesh(str(mesh), package, ()) == mesh


URL = "package://arm_description/meshes/b.stl"


def test_a_package_is_found_around_its_own_urdf_beside_that_of_another_and_in_folders_given(
    package: Path, tmp_path: Path
) -> None:
    other, elsewhere = package.parent / "cell_description" / "urdf", tmp_path / "elsewhere"
    other.mkdir(parents=True)
    for beside, given in (
        (package / "urdf", ()),
        (other, ()),
        (elsewhere, (package.parent,)),
        (elsewhere, (package,)),
    ):
        assert find_mesh(URL, beside, given) == package / "meshes" / "b.stl"


def test_a_package_in_a_folder_of_another_name_is_known_by_its_package_xml(package: Path) -> None:
    checkout = package.rename(package.parent / "arm-main")
    (checkout / "package.xml").write_text("<package><name>arm_description</name></package>")
    assert find_mesh(URL, checkout / "urdf", ()) == checkout / "meshes" / "b.stl"


def test_a_given_folder_comes_before_those_around_the_urdf(package: Path, tmp_path: Path) -> None:
    given = tmp_path / "given" / "arm_description" / "meshes" / "b.stl"
    given.parent.mkdir(parents=True)
    given.touch()
    assert find_mesh(URL, package / "urdf", (tmp_path / "given",)) == given


def test_the_environment_of_either_ros_names_folders_of_packages() -> None:
    environment = {"ROS_PACKAGE_PATH": "/ws/src:/opt/share", "AMENT_PREFIX_PATH": "/opt/ros/humble"}
    assert package_path(environment) == (Path("/ws/src"), Path("/opt/share"), Path("/opt/ros/humble/share"))
    assert package_path({}) == ()


def test_a_mesh_that_is_not_there_is_refused_with_the_paths_tried(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError) as refused:
        find_mesh("package://gone/b.stl", None, (tmp_path,))
    text = str(refused.value)
    assert str(tmp_path / "gone" / "b.stl") in text
    assert "--package-path" in text


def test_a_collision_mesh_that_is_not_there_stops_the_reading_with_file_and_link(package: Path, tmp_path: Path) -> None:
    (package / "urdf" / "r.urdf").write_text(urdf("../meshes/gone.stl"))
    (tmp_path / "r.srdf").write_text(SRDF)
    with pytest.raises(DescriptionError) as refused:
        model.load(package / "urdf" / "r.urdf", tmp_path / "r.srdf")
    for words in (str(package / "urdf" / "r.urdf"), "link 'b' <collision>", "gone.stl' is not there"):
        assert words in str(refused.value)


def test_a_mesh_that_is_only_seen_is_missed_in_the_log(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        model.parse(urdf("gone.dae", "visual"), SRDF, mesh_directory=tmp_path)
    assert "gone.dae" in caplog.text


def test_folders_given_and_of_the_environment_are_those_of_the_robot(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "r.urdf").write_text(urdf(URL))
    (tmp_path / "r.srdf").write_text(SRDF)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(package.parent))
    robot = model.load(tmp_path / "r.urdf", tmp_path / "r.srdf", (tmp_path,))
    assert robot.package_directories == (tmp_path, package.parent)


def test_collision_meshes_get_their_paths_for_names(package: Path) -> None:
    text = with_mesh_paths(urdf("../meshes/b.stl"), package / "urdf", ())
    assert f'filename="{package / "meshes" / "b.stl"}"' in text
