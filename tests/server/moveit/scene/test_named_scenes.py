"""Scenes that are saved by name."""

from __future__ import annotations

import asyncio

import pytest

from protocol.registry import Registry
from server.graph.node import Node
from server.graph.permissions import Role
from server.graph.topics import Graph
from server.moveit.scene import saved_scene
from server.moveit.scene.saved_scene import NamedScenes, offer_named_scenes
from tests.helpers.moveit import BENT, box, current_state, diff, held, scene_state
from tests.helpers.rules import server_rules


class Scenes:
    """A scene, and the services of the saved ones."""

    def __init__(self, folder, *objects):
        self.state = scene_state(*objects)
        self.graph = Graph(Registry.load())
        scenes = NamedScenes(folder, self.state, self.graph.message_types)
        offer_named_scenes(self.graph, scenes, current_state())

    async def call(self, service, **request):
        answered = asyncio.get_running_loop().create_future()
        self.graph.services.call(Node("client"), f"/arm/scenes/{service}", request, answered.set_result)
        async with asyncio.timeout(5.0):
            return (await answered).values


async def test_a_scene_comes_back_with_what_is_held_and_without_what_was_added_since(tmp_path):
    scenes = Scenes(tmp_path / "new", box("cup"), box("pen"))
    scenes.state.apply(scenes.state.attached_object(held("pen", touch_links=("gripper_link",))), BENT)
    assert (await scenes.call("save", name="Küche 1"))["success"]
    before = scenes.state.contents
    scenes.state.apply_diff(diff(world={"collision_objects": [box("new")]}), BENT)
    answer = await scenes.call("load", name="Küche 1")
    assert answer == {"success": True, "message": "the scene 'Küche 1' is loaded, with 2 objects"}
    assert list(scenes.state.contents.objects) == ["cup"]
    assert scenes.state.contents.attached["pen"].message == before.attached["pen"].message


async def test_scenes_are_listed_by_name_and_deleted(tmp_path):
    scenes = Scenes(tmp_path / "new", box("cup"))
    assert await scenes.call("list") == {"names": []}
    for name in ("b", "a"):
        assert (await scenes.call("save", name=name))["success"]
    assert await scenes.call("list") == {"names": ["a", "b"]}
    assert (await scenes.call("delete", name="a"))["success"]
    assert await scenes.call("list") == {"names": ["b"]}


async def test_more_scenes_than_the_limit_are_refused_but_a_known_one_is_replaced(tmp_path, monkeypatch):
    monkeypatch.setattr(saved_scene, "MAX_SCENES", 2)
    scenes = Scenes(tmp_path, box("cup"))
    for name in ("a", "b", "a"):
        assert (await scenes.call("save", name=name))["success"]
    assert "2 scenes are saved already, the limit is 2" in (await scenes.call("save", name="c"))["message"]
    assert await scenes.call("list") == {"names": ["a", "b"]}


async def test_a_scene_that_is_too_large_is_refused_and_the_old_one_stays(tmp_path, monkeypatch):
    scenes = Scenes(tmp_path, box("cup"))
    await scenes.call("save", name="a")
    before = (tmp_path / "a.json").read_bytes()
    monkeypatch.setattr(saved_scene, "MAX_SCENE_BYTES", 100)
    assert "more than 100 bytes" in (await scenes.call("save", name="a"))["message"]
    assert "more than 100 bytes" in (await scenes.call("load", name="a"))["message"]
    assert (tmp_path / "a.json").read_bytes() == before


@pytest.mark.parametrize("text", ["{", "[]", '{"is_diff": "x"}', '{"world": {"collision_objects": [{"id": 3}]}}'])
async def test_a_file_that_is_no_scene_changes_nothing(tmp_path, text):
    scenes = Scenes(tmp_path, box("cup"))
    (tmp_path / "bad.json").write_text(text)
    answer = await scenes.call("load", name="bad")
    assert not answer["success"]
    assert answer["message"].startswith("the scene 'bad' cannot be loaded: ")
    assert list(scenes.state.contents.objects) == ["cup"]


def test_saving_configures_and_loading_changes_the_scene():
    roles = {name: server_rules().services[f"/arm/scenes/{name}"].role for name in ("list", "load", "save", "delete")}
    assert roles == {"list": Role.VIEW, "load": Role.OPERATE, "save": Role.ADMIN, "delete": Role.ADMIN}
