from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from robot.description import model
from server.errors import FileTooLargeError, ServiceError
from server.moveit import robot_files
from server.moveit.robot_files import find_file, package_name, read_file, with_package_urls

ROBOT = model.builtin()
PACKAGE = "so101_description"


def urdf(*meshes: str) -> str:
    visuals = "".join(f'<visual><mesh filename="{mesh}"/></visual>' for mesh in meshes)
    return f'<robot name="so101"><link name="base">{visuals}</link></robot>'


@pytest.fixture
def files(tmp_path: Path) -> Path:
    (tmp_path / "secret.stl").write_text("key")
    directory = tmp_path / "robot"
    (directory / "assets").mkdir(parents=True)
    (directory / "assets" / "base.stl").write_bytes(b"solid")
    (directory / "assets" / "out.stl").symlink_to(tmp_path / "secret.stl")
    (directory / ".cache").mkdir()
    (directory / ".cache" / "a.png").write_bytes(b"PNG")
    (directory / "id_rsa").write_text("key")
    (directory / "arm.urdf").write_text("<robot/>")
    return directory


def test_the_package_is_named_as_those_of_ros_are() -> None:
    assert package_name(ROBOT) == PACKAGE


def test_meshes_named_by_a_path_get_package_urls_and_others_keep_theirs() -> None:
    served = with_package_urls(urdf("assets/base.stl", "./assets/arm.stl", "package://other/a.stl"), PACKAGE)
    names = [mesh.get("filename") for mesh in ET.fromstring(served).iter("mesh")]
    assert names == [
        f"package://{PACKAGE}/assets/base.stl",
        f"package://{PACKAGE}/assets/arm.stl",
        "package://other/a.stl",
    ]


def test_a_description_without_such_meshes_is_served_to_the_letter() -> None:
    assert with_package_urls(ROBOT.urdf, PACKAGE) == ROBOT.urdf


@pytest.mark.parametrize(
    "name",
    [
        "../secret.stl",
        f"package://{PACKAGE}/../secret.stl",
        "assets/out.stl",
        ".cache/a.png",
        "/etc/hosts",
        "assets",
        "",
        "no",
        "\0",
        "a" * 999,
    ],
)
def test_nothing_but_files_below_the_description_is_served(files: Path, name: str) -> None:
    with pytest.raises(ServiceError, match="name: "):
        read_file(files, PACKAGE, name)


def test_a_file_that_is_too_large_is_refused_with_the_limit(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_files, "MAX_FILE_BYTES", 4)
    with pytest.raises(FileTooLargeError, match="5 bytes, the limit is 4"):
        read_file(files, PACKAGE, "assets/base.stl")


def test_a_description_without_files_serves_none() -> None:
    with pytest.raises(ServiceError, match="names no files"):
        read_file(None, PACKAGE, "assets/base.stl")


@pytest.mark.parametrize("name", ["id_rsa", f"package://{PACKAGE}/id_rsa", "arm.urdf"])
def test_what_is_neither_mesh_nor_texture_is_not_served_from_somebodys_folder(files: Path, name: str) -> None:
    with pytest.raises(ServiceError, match="neither mesh nor texture"):
        read_file(files, PACKAGE, name)


@pytest.mark.parametrize(
    "name", ["assets/base.stl", f"package://{PACKAGE}/assets/base.stl", "package://robot/assets/base.stl"]
)
def test_the_package_may_have_the_name_of_the_robot_or_of_its_folder(files: Path, name: str) -> None:
    assert find_file(files, PACKAGE, name) == files / "assets" / "base.stl"


def test_a_folder_within_is_a_package_as_well(files: Path) -> None:
    inner = files / PACKAGE / "base.stl"
    inner.parent.mkdir()
    inner.write_bytes(b"solid")
    assert find_file(files, PACKAGE, f"package://{PACKAGE}/base.stl") == inner
    assert find_file(files, PACKAGE, "package://assets/base.stl") == files / "assets" / "base.stl"
