import asyncio
import logging

import pytest

from protocol.registry import Registry
from server.errors import RefusedError
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.scene import geometry_files
from server.moveit.scene.geometry_files import LOAD, SAVE, GeometryFiles, file_within
from tests.helpers.planning_scene import BENT, box, current_state, message, scene_state


class Files:
    """A scene whose geometry is saved and loaded."""

    def __init__(self, directory):
        self.state = scene_state(box("cup"), box("pen"))
        self.graph = Graph(Registry.load())
        GeometryFiles(self.graph, Node("scene"), self.state, directory).open(current_state())

    async def call(self, service, name):
        answered = asyncio.get_running_loop().create_future()
        self.graph.services.call(Node("client"), service, {"file_path_and_name": name}, answered.set_result)
        async with asyncio.timeout(5.0):
            return (await answered).values["success"]

    def empty(self):
        assert self.state.apply_world(message("PlanningSceneWorld"), BENT) is None


async def test_what_was_saved_is_loaded(tmp_path):
    files = Files(tmp_path)
    assert await files.call(SAVE, "kitchen.scene")
    before = files.state.contents.objects
    files.empty()
    assert await files.call(LOAD, str(tmp_path / "kitchen.scene"))
    assert list(files.state.contents.objects) == list(before)


async def test_what_the_file_does_not_name_stays(tmp_path):
    files = Files(tmp_path)
    assert await files.call(SAVE, "two.scene")
    other = Files(tmp_path)
    other.empty()
    assert (
        other.state.apply_diff(message("PlanningScene", is_diff=True, world={"collision_objects": [box("new")]}), BENT)
        is None
    )
    assert await other.call(LOAD, "two.scene")
    assert list(other.state.contents.objects) == ["new", "cup", "pen"]


@pytest.mark.parametrize("name", ["../x", "/etc/passwd", "a/../../x", "", ".", "\0", "x" * 5000])
@pytest.mark.parametrize("service", [SAVE, LOAD])
async def test_no_file_outside_the_folder_is_touched(tmp_path, service, name, caplog):
    with caplog.at_level(logging.WARNING, "armbridge"):
        assert not await Files(tmp_path).call(service, name)
    assert service in caplog.text
    assert list(tmp_path.iterdir()) == []


def test_a_link_that_leads_out_of_the_folder_is_followed_and_refused(tmp_path):
    (tmp_path / "inside").mkdir()
    (tmp_path / "inside" / "way out").symlink_to(tmp_path)
    with pytest.raises(RefusedError, match="must be a file in"):
        file_within(tmp_path / "inside", "way out/x")


def test_without_a_folder_there_are_no_files():
    with pytest.raises(RefusedError, match=r"moveit\.geometry_directory names no folder"):
        file_within(None, "x")


async def test_a_file_that_is_not_there_or_is_none_changes_nothing(tmp_path, caplog):
    files = Files(tmp_path)
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    (tmp_path / "text").write_text("nonsense")
    (tmp_path / "nan").write_text("s\n* b\n0 0 0\n0 0 0 1\n1\nsphere\nnan\n0 0 0\n0 0 0 1\n0 0 0 0\n0\n.\n")
    before = files.state.contents
    with caplog.at_level(logging.WARNING, "armbridge"):
        for name in ("absent", "binary", "text", "nan"):
            assert not await files.call(LOAD, name)
    assert files.state.contents is before
    assert len(caplog.records) == 4


async def test_the_size_of_files_is_bounded_both_ways(tmp_path, monkeypatch, caplog):
    files = Files(tmp_path)
    assert await files.call(SAVE, "fits")
    monkeypatch.setattr(geometry_files, "MAX_FILE_BYTES", 10)
    with caplog.at_level(logging.WARNING, "armbridge"):
        assert not await files.call(SAVE, "new")
        assert not await files.call(LOAD, "fits")
    assert caplog.text.count("more than 10") == 2
