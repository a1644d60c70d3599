from __future__ import annotations

import asyncio
import base64
import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest

from protocol.registry import Registry
from server import robot_files
from server.errors import FileTooLargeError, ServiceError
from server.graph.node import Node
from server.graph.services import Response
from server.graph.topics import Graph, Subscriber
from server.moveit.services.description import FILE_SERVICE, SRDF_TOPIC, URDF_TOPIC, RobotDescription
from server.robot_files import RobotFiles, package_name, with_package_urls
from tests.helpers.robots import so101

REGISTRY = Registry.load()
ROBOT = so101()
PACKAGE = "so101_description"
CLIENT = Node("client")


@pytest.mark.parametrize("topic", [URDF_TOPIC, SRDF_TOPIC])
def test_the_description_is_latched_and_kept_as_a_parameter(topic: str) -> None:
    graph = Graph(REGISTRY)
    parameters: dict[str, str] = {}
    RobotDescription(graph, ROBOT, parameters.__setitem__)
    (kept,) = graph.subscribe(CLIENT, topic, "std_msgs/String", Subscriber(lambda _: None))
    assert ET.fromstring(kept.msg["data"]).tag == "robot"
    name = topic.removeprefix("/")
    for parameter in (topic, name, f"/robot_state_publisher:{name}", f"/move_group:{name}"):
        assert json.loads(parameters[parameter]) == kept.msg["data"]


async def test_a_mesh_is_served_by_its_name_in_the_description(files: Path) -> None:
    graph = Graph(REGISTRY)
    RobotDescription(graph, replace(ROBOT, mesh_directory=files), lambda _name, _value: None)
    answered: asyncio.Future[Response] = asyncio.get_running_loop().create_future()
    graph.services.call(CLIENT, FILE_SERVICE, {"name": f"package://{PACKAGE}/assets/base.stl"}, answered.set_result)
    assert base64.b64decode((await answered).values["value"]) == b"solid"


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


def test_the_package_has_a_name_in_the_style_of_ros() -> None:
    assert package_name(ROBOT) == PACKAGE


def test_meshes_named_by_a_path_get_package_urls_and_others_keep_theirs() -> None:
    served = with_package_urls(urdf("assets/base.stl", "./assets/arm.stl", "package://other/a.stl"), PACKAGE)
    names = [mesh.get("filename") for mesh in ET.fromstring(served).iter("mesh")]
    assert names == [
        f"package://{PACKAGE}/assets/base.stl",
        f"package://{PACKAGE}/assets/arm.stl",
        "package://other/a.stl",
    ]


def test_a_description_without_mesh_paths_is_unchanged() -> None:
    assert with_package_urls(ROBOT.urdf, PACKAGE) == ROBOT.urdf


def files_in(directory: Path | None) -> RobotFiles:
    return RobotFiles(replace(ROBOT, mesh_directory=directory))


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
def test_only_files_below_the_description_are_served(files: Path, name: str) -> None:
    with pytest.raises(ServiceError, match="name: "):
        files_in(files).read(name)


def test_a_file_that_is_too_large_is_refused_with_the_limit(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_files, "MAX_FILE_BYTES", 4)
    with pytest.raises(FileTooLargeError, match="5 bytes, the limit is 4"):
        files_in(files).read("assets/base.stl")


def test_a_description_without_files_serves_none() -> None:
    with pytest.raises(ServiceError, match="names no files"):
        files_in(None).read("assets/base.stl")


@pytest.mark.parametrize("name", ["id_rsa", f"package://{PACKAGE}/id_rsa", "arm.urdf"])
def test_only_meshes_and_textures_are_served(files: Path, name: str) -> None:
    with pytest.raises(ServiceError, match="neither mesh nor texture"):
        files_in(files).read(name)


@pytest.mark.parametrize(
    "name", ["assets/base.stl", f"package://{PACKAGE}/assets/base.stl", "package://robot/assets/base.stl"]
)
def test_the_package_may_have_the_name_of_the_robot_or_of_its_folder(files: Path, name: str) -> None:
    assert files_in(files).find(name) == files / "assets" / "base.stl"


def test_a_folder_within_is_a_package_as_well(files: Path) -> None:
    inner = files / PACKAGE / "base.stl"
    inner.parent.mkdir()
    inner.write_bytes(b"solid")
    assert files_in(files).find(f"package://{PACKAGE}/base.stl") == inner
    assert files_in(files).find("package://assets/base.stl") == files / "assets" / "base.stl"


@pytest.fixture
def packaged(tmp_path: Path) -> RobotFiles:
    """Files of an arm whose URDF is in one package and whose meshes are in another, beside it."""
    (tmp_path / "arm_meshes" / "meshes" / "visual").mkdir(parents=True)
    (tmp_path / "arm_meshes" / "secret.stl").write_text("key")
    for name in ("base.dae", "skin.png", "notes.txt"):
        (tmp_path / "arm_meshes" / "meshes" / "visual" / name).write_text(name)
    folder = tmp_path / "arm_description" / "urdf"
    folder.mkdir(parents=True)
    meshes = "package://arm_meshes/meshes/visual/base.dae", "package://gone/a.stl"
    return RobotFiles(replace(ROBOT, urdf=urdf(*meshes), mesh_directory=folder, package_directories=(tmp_path,)))


@pytest.mark.parametrize("name", ["base.dae", "skin.png"])
def test_files_beside_the_meshes_of_a_package_are_served(packaged: RobotFiles, name: str) -> None:
    assert packaged.read(f"package://arm_meshes/meshes/visual/{name}") == name.encode()


ELSEWHERE = (
    "package://arm_meshes/secret.stl",
    "package://arm_meshes/meshes/visual/../../secret.stl",
    "package://arm_meshes/meshes/visual/notes.txt",
    "package://gone/a.stl",
)


@pytest.mark.parametrize("name", ELSEWHERE)
def test_nothing_else_of_a_package_is_served(packaged: RobotFiles, name: str) -> None:
    with pytest.raises(ServiceError, match="name: "):
        packaged.read(name)
