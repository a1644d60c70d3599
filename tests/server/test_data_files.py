"""Files of the data directory that older and newer versions have written."""

import asyncio
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from server.config import Settings
from server.disk import TIMEOUT_S, Disk
from server.errors import ServiceError
from server.features.moveit import kept_scene_path
from server.graph.message_types import MessageTypes
from server.moveit.named_states import NamedStates
from server.moveit.scene.saved_scene import complete_scene
from server.named_files import FileSeries, read_json, set_aside
from server.teaching.taught_motion import MotionFiles
from tests.helpers.clock import FakeClock
from tests.helpers.moveit import REGISTRY, ROBOT

# Written by version 0.1.0: never change them; add a folder for a version whose formats differ.
WRITTEN = Path(__file__).parent / "data_of_0_1_0"

# What a newer version may have added.
NEWER = {"written_by": "9.9.9"}


@pytest.mark.parametrize("more", [{}, NEWER], ids=["of 0.1.0", "of a newer version"])
async def test_saved_states_and_taught_motions_open(tmp_path: Path, more: dict[str, str]) -> None:
    for name in ("named_states_so101.json", "wave.json"):
        content = json.loads((WRITTEN / name).read_text())
        (tmp_path / name).write_text(json.dumps({**content, **more}))
    states = NamedStates(ROBOT, "arm", tmp_path / "named_states_so101.json")
    assert states.saved == {"tray": {"shoulder_pan": 0.25, "elbow_flex": -0.5}}
    motion = await MotionFiles(tmp_path, ROBOT).load("wave")
    assert motion.joint_names == ("shoulder_pan",)
    assert motion.positions_rad.tolist() == [[0.0], [0.1], [0.2]]


def test_the_planning_scene_of_an_older_version_opens(tmp_path: Path) -> None:
    path = tmp_path / "planning_scene_so101.json"
    shutil.copy(WRITTEN / path.name, path)
    content: Any = read_json(path, 1_000_000)
    scene = complete_scene(MessageTypes(REGISTRY, FakeClock()), content)
    assert [each["id"] for each in scene["world"]["collision_objects"]] == ["box"]


def test_an_arm_its_simulation_and_each_set_of_arms_keep_a_scene_of_their_own() -> None:
    for settings, name in (
        ({}, "planning_scene_so101.json"),
        ({"arm": {"serial": "/dev/ttyACM0"}}, "planning_scene_real_so101.json"),
        ({"arms": {"right": {"serial": "/dev/a"}, "left": {}}}, "planning_scene_left_right_real_so101.json"),
    ):
        assert kept_scene_path(Settings.model_validate(settings), ROBOT).name == name


def test_a_new_file_is_kept_though_the_clock_that_names_it_was_set_back(tmp_path: Path) -> None:
    series = FileSeries(tmp_path, "fault-", ".jsonl", 3)
    for name in ("2046", "2047", "2048", "2026", "2027"):
        newest = series.add(name, name.encode)
        assert newest.read_bytes() == name.encode()
    assert len(series.paths()) == 3


def test_files_that_are_set_aside_never_take_each_others_place(tmp_path: Path) -> None:
    path = tmp_path / "states.json"
    for number in range(3):
        path.write_text(str(number))
        set_aside(path)
    assert {each.name: each.read_text() for each in tmp_path.iterdir()} == {
        "states.json.broken": "0",
        "states.json.broken.1": "1",
        "states.json.broken.2": "2",
    }


@pytest.mark.stepped_time
async def test_work_behind_work_that_does_not_end_is_refused_at_once_until_the_disk_answers_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    answers, loop, disk = asyncio.Event(), asyncio.get_running_loop(), Disk()

    async def in_thread(work: Callable[[], object]) -> object:
        await answers.wait()
        return work()

    monkeypatch.setattr(asyncio, "to_thread", in_thread)
    began_s = loop.time()
    outcomes = await asyncio.gather(*(disk.do(list) for _ in range(5)), return_exceptions=True)
    assert [str(outcome) for outcome in outcomes] == 5 * ["[Errno 110] the disk does not answer within 5 s"]
    assert loop.time() == pytest.approx(began_s + TIMEOUT_S)
    with pytest.raises(ServiceError, match="the file cannot be read: it: the disk does not answer"):
        await disk.serve("it", "the file cannot be read", list)
    answers.set()
    await asyncio.sleep(0.0)
    assert await disk.do(lambda: 3) == 3
