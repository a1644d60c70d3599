"""Saving and loading the geometry of a scene."""

import json
import logging

import pytest

from server.errors import RefusedError
from server.graph.topics import Graph
from server.moveit.scene import saved_scene
from tests.helpers.graph import called
from tests.helpers.moveit import BENT, REGISTRY, box, current_state, diff, message, scene_state

COLOR = {"r": 0.5, "g": 0.25, "b": 0.0, "a": 1.0}


class Files:
    """A scene whose geometry is saved and loaded."""

    def __init__(self, directory):
        self.state = scene_state(box("cup"), box("pen"))
        self.graph = Graph(REGISTRY)
        saved_scene.offer_geometry_files(self.graph, self.state, current_state(), directory)

    async def call(self, service, name):
        return (await called(self.graph, service, file_path_and_name=name)).values["success"]


async def test_a_saved_scene_is_loaded(tmp_path):
    files = Files(tmp_path)
    files.state.apply_diff(diff(object_colors=[{"id": "cup", "color": COLOR}]), BENT)
    assert await files.call(saved_scene.SAVE, "kitchen.scene")
    files.state.apply(files.state.world(message("PlanningSceneWorld")), BENT)
    assert files.state.contents.objects == {}
    assert await files.call(saved_scene.LOAD, str(tmp_path / "kitchen.scene"))
    assert list(files.state.contents.objects) == ["cup", "pen"]
    assert files.state.contents.colors == {"cup": COLOR}


@pytest.mark.parametrize("service", [saved_scene.SAVE, saved_scene.LOAD])
async def test_no_file_outside_the_folder_is_touched(tmp_path, service, caplog):
    files = Files(tmp_path)
    for name in ("../x", "/etc/passwd", "a/../../x", "", ".", "\0", "x" * 5000):
        with caplog.at_level(logging.WARNING, "armbridge"):
            assert not await files.call(service, name), name
        assert service in caplog.text
        caplog.clear()
    assert list(tmp_path.iterdir()) == []


def test_a_link_that_leads_out_of_the_folder_is_refused_and_without_a_folder_every_file(tmp_path):
    (tmp_path / "inside").mkdir()
    (tmp_path / "inside" / "way out").symlink_to(tmp_path)
    with pytest.raises(RefusedError, match="must be a file in"):
        saved_scene.file_within(tmp_path / "inside", "way out/x")
    with pytest.raises(RefusedError, match=r"moveit\.geometry_directory names no folder"):
        saved_scene.file_within(None, "x")


async def test_a_missing_or_malformed_file_changes_nothing(tmp_path, caplog):
    files = Files(tmp_path)
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    (tmp_path / "text").write_text("nonsense")
    box_of_nan = {**box("b"), "primitives": [{"type": 2, "dimensions": [None]}]}
    (tmp_path / "nan").write_text(json.dumps({"world": {"collision_objects": [box_of_nan]}}))
    before = files.state.contents
    with caplog.at_level(logging.WARNING, "armbridge"):
        for name in ("absent", "binary", "text", "nan"):
            assert not await files.call(saved_scene.LOAD, name)
    assert files.state.contents is before
    assert len(caplog.records) == 4


async def test_the_size_of_files_is_bounded_both_ways(tmp_path, monkeypatch, caplog):
    files = Files(tmp_path)
    assert await files.call(saved_scene.SAVE, "fits")
    monkeypatch.setattr(saved_scene, "MAX_SCENE_BYTES", 10)
    with caplog.at_level(logging.WARNING, "armbridge"):
        assert not await files.call(saved_scene.SAVE, "new")
        assert not await files.call(saved_scene.LOAD, "fits")
    assert caplog.text.count("more than 10") == 2
