from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from robot import files
from server.graph.message_types import MessageTypes
from server.graph.permissions import Role
from server.graph.topics import Graph
from server.moveit.scene import saved_scene
from server.moveit.scene.interface import EVERYTHING, NO_STATE, scene_message
from server.moveit.scene.saved_scene import (
    DELAY_S,
    DISK_TIMEOUT_S,
    WRITING_SHARE,
    NamedScenes,
    SavedScene,
    offer_named_scenes,
)
from server.moveit.scene.scene_state import SceneState
from server.named_files import read_json
from tests.helpers.clock import SteppedLoop
from tests.helpers.graph import called
from tests.helpers.moveit import BENT, REGISTRY, ROBOT, box, current_state, diff, held, pose, scene_state
from tests.helpers.rules import server_rules
from tests.helpers.stage import inline_threads

pytestmark = pytest.mark.stepped_time

CORNERS = [{"x": 0.0, "y": 0.0, "z": 0.0}, {"x": 0.1, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 0.1, "z": 0.0}]
MESH = {"triangles": [{"vertex_indices": [0, 1, 2]}], "vertices": CORNERS}
CUBE = {"type": 1, "dimensions": [0.05, 0.05, 0.05]}
COLOR = {"r": 1.0, "g": 0.5, "b": 0.0, "a": 1.0}

# After so long, a change is written.
WRITTEN_S = 1.1 * DELAY_S


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "armbridge" / "scene.json"


@pytest.fixture(autouse=True)
def _threads(monkeypatch: pytest.MonkeyPatch) -> None:
    inline_threads(monkeypatch)


class Run:
    """One run of a server, as far as its scene goes."""

    def __init__(self, path: Path) -> None:
        self.state, self.path = SceneState(ROBOT), path
        self.saved = SavedScene(path, self.state, MessageTypes(REGISTRY))

    async def __aenter__(self) -> Run:
        await self.saved.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.saved.close()

    def apply(self, **fields: Any) -> None:
        self.state.apply_diff(diff(**fields), BENT)

    def add(self, *names: str) -> None:
        self.apply(world={"collision_objects": [box(name, at=pose(x=0.5)) for name in names]})

    def message(self) -> dict[str, Any]:
        return scene_message(self.state.contents, ROBOT, NO_STATE, EVERYTHING)

    def written(self) -> list[str] | None:
        """Names of the objects in the file; None without a file."""
        if not self.path.exists():
            return None
        return [each["id"] for each in read_json(self.path, 10_000)["world"]["collision_objects"]]


async def test_all_that_clients_added_is_there_at_the_next_start(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    names = [*ROBOT.links, "wall"]
    async with Run(path) as run:
        mesh = {
            "id": "mesh",
            "meshes": [MESH],
            "pose": pose(y=0.4),
            "subframe_names": ["tip"],
            "subframe_poses": [pose()],
        }
        cup = held("cup", touch_links=("moving_jaw_so101_v1_link",), primitives=[CUBE])
        run.apply(
            name="kitchen",
            world={"collision_objects": [box("wall", at=pose(x=0.5)), mesh]},
            robot_state={"attached_collision_objects": [cup]},
            allowed_collision_matrix={
                "entry_names": names,
                "entry_values": [{"enabled": [True] * len(names)} for _ in names],
                "default_entry_names": ["mesh"],
                "default_entry_values": [True],
            },
            link_padding=[{"link_name": "gripper_link", "padding": 0.01}],
            object_colors=[{"id": "wall", "color": COLOR}],
        )
        kept = run.message()
    async with Run(path) as again:
        assert again.message() == kept
        assert [each.pose for each in again.state.scene.objects] == [each.pose for each in run.state.scene.objects]
    assert f"the planning scene is restored from {path}: 3 objects, 1 of them held" in caplog.text


async def test_changes_are_written_together_after_a_while_and_the_last_ones_at_the_end(path: Path) -> None:
    async with Run(path) as run:
        run.add("a")
        await asyncio.sleep(0.9 * DELAY_S)
        run.add("b")
        assert run.written() is None
        await asyncio.sleep(0.2 * DELAY_S)
        assert run.written() == ["a", "b"]
        run.add("c")
        assert run.written() == ["a", "b"]
    assert run.written() == ["a", "b", "c"]
    # A matrix that nobody changed is left to the description.
    assert read_json(path, 10_000)["allowed_collision_matrix"]["entry_names"] == []


async def test_what_changes_while_it_is_written_is_written_next_and_to_a_slow_disk_less_often(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with Run(path) as run:
        write = run.saved._replace

        def slow(content: Any) -> None:
            run.add("b")
            cast("SteppedLoop", asyncio.get_running_loop()).advance(2.0)
            write(content)

        with monkeypatch.context() as patched:
            patched.setattr(run.saved, "_replace", slow)
            run.add("a")
            await asyncio.sleep(WRITTEN_S)
        await asyncio.sleep(0.9 * 2.0 / WRITING_SHARE)
        assert run.written() == ["a"]
        await asyncio.sleep(0.2 * 2.0 / WRITING_SHARE)
        assert run.written() == ["a", "b"]


BROKEN = [
    "{",
    "[" * 100_000,
    # No UTF-8.
    "\udcff",
    "[]",
    '{"world": {"collision_objects": "all"}}',
    '{"world": {"collision_objects": [7]}}',
    '{"world": {"collision_objects": [{"id": "x"}]}}',
    json.dumps({"robot_state": {"attached_collision_objects": [held("cup", "tail")]}}),
]


@pytest.mark.parametrize("content", BROKEN, ids=range(len(BROKEN)))
async def test_an_unrestorable_file_is_set_aside(path: Path, content: str, caplog: pytest.LogCaptureFixture) -> None:
    octets = content.encode("utf-8", "surrogateescape")
    with files.locked(path):
        files.replace(path, octets)
    async with Run(path) as run:
        assert run.state.contents == SceneState(ROBOT).contents
        run.add("wall")
    assert run.written() == ["wall"]
    assert path.with_name("scene.json.broken").read_bytes() == octets
    assert "cannot be restored" in caplog.text


# There is a folder in its place, or a file in that of its folder.
@pytest.mark.parametrize("name", ["scene.json", "file/scene.json"])
async def test_an_unusable_file_prevents_nothing(tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "scene.json").mkdir()
    async with Run(tmp_path / name) as run:
        run.add("wall")
    assert (tmp_path / "scene.json").is_dir()
    assert "the planning scene is not kept" in caplog.text


async def test_a_scene_that_is_too_large_is_told_once_and_leaves_no_older_one(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async with Run(path) as run:
        run.add("a")
        await asyncio.sleep(WRITTEN_S)
        monkeypatch.setattr(saved_scene, "MAX_FILE_BYTES", 100)
        for name in "bc":
            run.add(name)
            await asyncio.sleep(WRITTEN_S)
        assert caplog.text.count("more than 100 bytes") == 1
        assert run.written() is None


async def test_a_server_begins_without_a_scene_that_its_disk_does_not_give(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    inline = asyncio.to_thread

    async def in_thread(work: Callable[[], object]) -> object:
        # The lock is given, and the file is not.
        monkeypatch.setattr(asyncio, "to_thread", lambda _work: asyncio.Event().wait())
        return await inline(work)

    monkeypatch.setattr(asyncio, "to_thread", in_thread)
    await SavedScene(path, SceneState(ROBOT), MessageTypes(REGISTRY)).start()
    assert f"not kept in {path}: the disk does not answer within 20 s" in caplog.text


async def test_a_server_goes_on_and_ends_though_its_disk_does_not_take_the_scene(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async with Run(path) as run:
        monkeypatch.setattr(asyncio, "to_thread", lambda *_work: asyncio.Event().wait())
        run.add("a")
        await asyncio.sleep(WRITTEN_S + DISK_TIMEOUT_S)
        run.add("b")
    assert caplog.text.count("the disk does not answer within 20 s") == 1


def is_locked(path: Path) -> bool:
    lock = files.FileLock(path)
    try:
        lock.acquire()
    except files.FileLockedError:
        return True
    lock.release()
    return False


class StuckDisk:
    """A disk that does not answer until it is let go."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.answers = asyncio.Event()
        self._inline = asyncio.to_thread
        monkeypatch.setattr(asyncio, "to_thread", self._work)

    async def _work(self, work: Callable[[], object]) -> object:
        await self.answers.wait()
        return await self._inline(work)


async def test_a_file_whose_write_the_disk_holds_is_no_other_server_s_before_that_has_ended(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with Run(path) as run:
        disk = StuckDisk(monkeypatch)
        run.add("a")
        await asyncio.sleep(WRITTEN_S)
    assert is_locked(path)
    disk.answers.set()
    await asyncio.sleep(DELAY_S)
    assert (run.written(), is_locked(path)) == (["a"], False)


async def test_a_lock_that_the_disk_gives_too_late_is_given_back(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = StuckDisk(monkeypatch)
    async with Run(path):
        disk.answers.set()
        await asyncio.sleep(DELAY_S)
        assert not is_locked(path)


async def test_a_second_server_keeps_its_hands_off_the_first_ones_scene(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(files, "LOCK_TIMEOUT_S", 0.0)
    async with Run(path) as first:
        first.add("wall")
        await asyncio.sleep(WRITTEN_S)
        async with Run(path) as second:
            assert second.state.contents.objects == {}
            second.add("mine")
        assert f"{path} is in use by armbridge (process {os.getpid()}); give one of the two servers" in caplog.text
        assert first.written() == ["wall"]
    async with Run(path) as third:
        assert list(third.state.contents.objects) == ["wall"]


class Scenes:
    """A scene, and the services of the saved ones."""

    def __init__(self, folder, *objects):
        self.state = scene_state(*objects)
        self.graph = Graph(REGISTRY)
        scenes = NamedScenes(folder, self.state, self.graph.message_types)
        offer_named_scenes(self.graph, scenes, current_state())

    async def call(self, service, **request):
        return (await called(self.graph, f"/arm/scenes/{service}", **request)).values


async def test_a_scene_comes_back_with_what_is_held_and_without_what_was_added_since(tmp_path):
    scenes = Scenes(tmp_path / "new", box("cup"), box("pen"))
    scenes.state.apply(scenes.state.attached_object(held("pen", touch_links=("gripper_link",))).apply, BENT)
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
    for service, name, names in (("save", "b", ["b"]), ("save", "a", ["a", "b"]), ("delete", "b", ["a"])):
        assert (await scenes.call(service, name=name))["success"]
        assert await scenes.call("list") == {"names": names}


async def test_a_scene_that_is_too_large_is_refused_and_the_old_one_stays(tmp_path, monkeypatch):
    scenes = Scenes(tmp_path, box("cup"))
    await scenes.call("save", name="a")
    before = (tmp_path / "a.json").read_bytes()
    monkeypatch.setattr(saved_scene, "MAX_SCENE_BYTES", 100)
    for service in ("save", "load"):
        assert "more than 100 bytes" in (await scenes.call(service, name="a"))["message"]
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
