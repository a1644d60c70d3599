"""Saving and loading the geometry of a scene."""

import logging
import math

import pytest

from planners.scene import Cylinder
from server.errors import RefusedError
from server.graph.topics import Graph
from server.moveit.scene import geometry_files
from tests.helpers.graph import called
from tests.helpers.moveit import BENT, REGISTRY, box, current_state, diff, message, pose, rejection, scene_state


class Files:
    """A scene whose geometry is saved and loaded."""

    def __init__(self, directory):
        self.state = scene_state(box("cup"), box("pen"))
        self.graph = Graph(REGISTRY)
        geometry_files.offer_geometry_files(self.graph.node("scene"), self.state, current_state(), directory)

    async def call(self, service, name):
        return (await called(self.graph, service, file_path_and_name=name)).values["success"]


async def test_a_saved_scene_is_loaded_and_its_size_bounded_both_ways(tmp_path, monkeypatch, caplog):
    files = Files(tmp_path)
    assert await files.call(geometry_files.SAVE, "kitchen.scene")
    files.state.apply(files.state.world(message("PlanningSceneWorld")).apply, BENT)
    assert files.state.contents.objects == {}
    assert await files.call(geometry_files.LOAD, str(tmp_path / "kitchen.scene"))
    assert list(files.state.contents.objects) == ["cup", "pen"]
    assert await files.call(geometry_files.SAVE, "fits")
    monkeypatch.setattr(geometry_files, "MAX_FILE_BYTES", 10)
    with caplog.at_level(logging.WARNING, "armbridge"):
        assert not await files.call(geometry_files.SAVE, "new")
        assert not await files.call(geometry_files.LOAD, "fits")
    assert caplog.text.count("more than 10") == 2


@pytest.mark.parametrize("service", [geometry_files.SAVE, geometry_files.LOAD])
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
        geometry_files.file_within(tmp_path / "inside", "way out/x")
    with pytest.raises(RefusedError, match=r"moveit\.geometry_directory names no folder"):
        geometry_files.file_within(None, "x")


async def test_a_missing_or_malformed_file_changes_nothing(tmp_path, caplog):
    files = Files(tmp_path)
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    (tmp_path / "text").write_text("nonsense")
    (tmp_path / "nan").write_text("s\n* b\n0 0 0\n0 0 0 1\n1\nsphere\nnan\n0 0 0\n0 0 0 1\n0 0 0 0\n0\n.\n")
    before = files.state.contents
    with caplog.at_level(logging.WARNING, "armbridge"):
        for name in ("absent", "binary", "text", "nan"):
            assert not await files.call(geometry_files.LOAD, name)
    assert files.state.contents is before
    assert len(caplog.records) == 4


EDGES = [{"x": 0.0, "y": 0.0, "z": 0.0}, {"x": 0.1, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 0.3, "z": 0.0}]
RACK = {
    "id": "a rack",
    "pose": pose(0.3, 1 / 3, turned=(0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))),
    "primitives": [
        {"type": 1, "dimensions": [0.1, 0.2, 1e-9]},
        {"type": 2, "dimensions": [0.1]},
        {"type": 3, "dimensions": [0.5, 0.1]},
        {"type": 4, "dimensions": [0.5, 0.1]},
    ],
    "primitive_poses": [pose(0.1 * i) for i in range(4)],
    "meshes": [{"vertices": EDGES, "triangles": [{"vertex_indices": [0, 1, 2]}]}],
    "planes": [{"coef": [0.0, 0.0, 1.0, 0.5]}],
    "subframe_names": ["left hook"],
    "subframe_poses": [pose(0.0, 0.4)],
}


def test_every_shape_and_subframe_comes_back_from_the_text_exactly_with_a_colour_behind_each_shape():
    state = scene_state(RACK, box("cup"))
    color = {"r": 0.5, "g": 0.25, "b": 0.0, "a": 1.0}
    state.apply_diff(diff(object_colors=[{"id": "cup", "color": color}]), BENT)
    text = geometry_files.write_geometry(state.contents)
    assert "0.5 0.25 0.0 1.0" in text.splitlines()
    before, after = (
        state.contents.objects,
        scene_state(*geometry_files.read_geometry(text, "base_link")).contents.objects,
    )
    assert [(name, each.message) for name, each in after.items()] == [(n, each.message) for n, each in before.items()]


def test_moveit_s_own_text_is_read_in_both_versions():
    text = "(noname)\n* Can\n0.1 0.2 0.3\n0 0 0 1\n1\ncylinder\n0.03 0.12\n0 0 0\n0 0 0 1\n0 0 0 0\n0\n.\n"
    (can,) = scene_state(*geometry_files.read_geometry(text, "")).contents.objects.values()
    assert (can.pose.position_m, can.shapes[0][0]) == ((0.1, 0.2, 0.3), Cylinder(0.03, 0.12))
    text = "(noname)\n* Box\n1\nbox\n0.1 0.1 0.1\n0.5 0 0\n0 0 0 1\n0 0 0 0\n.\n"
    (thing,) = scene_state(*geometry_files.read_geometry(text, "")).contents.objects.values()
    assert thing.pose.position_m == (0.5, 0.0, 0.0)


GOOD = "s\n* b\n0 0 0\n0 0 0 1\n1\nbox\n1 1 1\n0 0 0\n0 0 0 1\n0 0 0 0\n0\n.\n"
NUMBER = "line 5 must be the number of shapes"
BAD = [
    ("", "the file ends after line 0"),
    (GOOD.replace(".", "* c"), "the file ends after line 12"),
    (GOOD.replace("* b", "b"), "line 2 must be '* ID' or '.'"),
    (GOOD.replace("box", "torus"), "line 6 must be one of box, sphere"),
    (GOOD.replace("1 1 1", "1 one 1"), "line 7 must be a box's edges"),
    (GOOD.replace("1 1 1", "1 1"), "line 7 must be a box's edges"),
    *((GOOD.replace("\n1\n", f"\n{number}\n"), NUMBER) for number in ("0.5", "1000000000", "-1", "inf")),
]


@pytest.mark.parametrize(("text", "words"), BAD)
def test_a_wrong_line_is_refused_by_its_number(text, words):
    assert geometry_files.read_geometry(GOOD, "")
    assert words in rejection(geometry_files.read_geometry, text, "").message
