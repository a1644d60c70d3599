from __future__ import annotations

import asyncio
import dataclasses
import os
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from planners.cluster import link as link_module
from planners.cluster import tasks
from planners.cluster.contract import contract
from planners.cluster.link import Link, digest
from planners.cluster.messages import Missing, SceneKey
from planners.scene import Box, Pose, Scene, SceneObject
from robot.description import model
from tests.helpers.requests import EASY

ROOT = Path(__file__).parents[3]
ROBOT = model.builtin()
OBJECTS = tuple(
    SceneObject(f"box {i}", ((Box((0.1, 0.1, 0.1)), Pose()),), Pose((2.0 + i, 0.0, 0.0))) for i in range(300)
)


class Client:
    """Stands for Dask's: keeps what it is given, and answers what it was told to."""

    def __init__(self) -> None:
        self.status = "running"
        self.ran: list[tuple[Any, ...]] = []
        self.submitted: list[tuple[tuple[Any, ...], dict[str, Any]]] = []
        self.answers: dict[Callable[..., Any], Any] = {tasks.agree: contract()}
        self.present = True

    async def run(self, function: Callable[..., Any], *arguments: object, workers: list[str]) -> dict[str, Any]:
        await asyncio.sleep(0)
        self.ran.append((workers[0], function, *arguments))
        answer = self.answers.get(function)
        if isinstance(answer, Exception):
            raise answer
        return {workers[0]: answer} if self.present else {}

    async def nthreads(self) -> dict[str, int]:
        if "nthreads" in self.status:
            await asyncio.sleep(60.0)
        return {"a": 2}

    def submit(self, *arguments: object, **options: object) -> str:
        self.submitted.append((arguments, options))
        return "future"

    async def close(self) -> None:
        if self.status == "hangs":
            await asyncio.sleep(60.0)
        self.status = "closed"


def linked() -> tuple[Client, Link]:
    client = Client()
    return client, Link(cast("Any", client), ROBOT, 1000)


async def test_a_worker_that_agrees_gets_the_robot() -> None:
    client, link = linked()
    assert await link.recruit("a") is None
    assert [call[1] for call in client.ran] == [tasks.agree, tasks.take_robot]
    _, _, digest, robot, limit = client.ran[1]
    assert len(digest) == 64
    assert pickle.loads(robot).name == ROBOT.name
    assert limit == 1000


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        ("0.0.1 (planners 0)", r"it runs armbridge 0\.0\.1 .* install the same on both"),
        (ModuleNotFoundError("No module named 'planners.cluster'"), "cannot run armbridge: No module named .*install"),
        (AttributeError("no agree"), "cannot run armbridge: no agree"),
    ],
)
async def test_a_worker_of_another_armbridge_is_refused_before_anything_is_sent(
    answer: str | Exception, told: str
) -> None:
    client, link = linked()
    client.answers[tasks.agree] = answer
    refusal = await link.recruit("a")
    assert refusal is not None
    assert re.search(told, refusal)
    assert contract() in refusal
    assert [call[1] for call in client.ran] == [tasks.agree]


async def test_a_robot_that_cannot_be_loaded_there_is_told() -> None:
    client, link = linked()
    client.answers[tasks.take_robot] = "no meshes"
    assert await link.recruit("a") == "no meshes"


async def test_a_worker_that_has_left_is_out_of_reach() -> None:
    client, link = linked()
    client.present = False
    with pytest.raises(ConnectionError, match="worker a has left"):
        await link.recruit("a")


async def test_a_scene_goes_in_parts_that_make_it_whole() -> None:
    client, link = linked()
    await link.supply(Missing("a", robot=False), Scene(4, OBJECTS))
    assert {call[1] for call in client.ran} == {tasks.take_scene_part}
    assert len({call[3] for call in client.ran}) == 1
    first, *objects, last = (pickle.loads(call[4]) for call in client.ran)
    assert (first.version, first.objects) == (4, ())
    assert len(objects) > 1
    assert tuple(each for part in objects for each in part) == OBJECTS
    assert isinstance(last, SceneKey)
    assert last.version == 4


async def test_a_worker_without_the_robot_gets_that_first() -> None:
    client, link = linked()
    await link.supply(Missing("a", robot=True), Scene(4))
    assert client.ran[0][1] is tasks.take_robot


async def test_a_request_goes_to_any_member_and_is_repeated_where_the_scene_is() -> None:
    client, link = linked()
    link.members = ["a", "b"]
    link.submit(EASY, Scene(), None)
    link.submit(EASY, Scene(), "b")
    (_, first), (_, again) = client.submitted
    assert (first["workers"], first["allow_other_workers"]) == (["a", "b"], False)
    assert (again["workers"], again["allow_other_workers"]) == (["b"], True)


async def test_a_task_has_a_name_of_its_own_and_finds_it_by_its_token() -> None:
    client, link = linked()
    link.submit(EASY, Scene(), None)
    link.submit(EASY, Scene(), None)
    names = [options["key"] for _, options in client.submitted]
    assert len(set(names)) == 2
    # Dask would take an argument that is a task's name for that task's result.
    assert [tasks.TASK_PREFIX + arguments[1] for arguments, _ in client.submitted] == names


async def test_servers_call_their_scenes_by_different_keys() -> None:
    keys = []
    for _ in range(2):
        client, link = linked()
        link.submit(EASY, Scene(3), None)
        keys.append(pickle.loads(client.submitted[0][0][3]))
    assert keys[0] != keys[1]
    assert [key.version for key in keys] == [3, 3]


async def test_nothing_is_submitted_to_a_scheduler_that_is_gone() -> None:
    client, link = linked()
    client.status = "connecting"
    assert not link.open
    with pytest.raises(ConnectionError, match="gone"):
        link.submit(EASY, Scene(), None)


async def test_a_scheduler_that_does_not_answer_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_module, "CLOSE_TIMEOUT_S", 0.01)
    client, link = linked()
    assert await link.threads(1.0) == {"a": 2}
    client.status = "nthreads hangs"
    with pytest.raises(TimeoutError):
        await link.threads(0.01)
    client.status = "hangs"
    await asyncio.wait_for(link.close(), 1.0)


def test_a_robot_has_the_same_digest_in_every_process() -> None:
    program = "from planners.cluster.link import digest; from robot.description import model; print(digest(model.builtin(), 1000))"
    told = {
        subprocess.run(
            [sys.executable, "-c", program],
            cwd=ROOT,
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
        ).stdout.strip()
        for seed in ("1", "2")
    }
    assert told == {digest(ROBOT, 1000)}


DIFFERENT = {
    "urdf": {"urdf": ROBOT.urdf + "\n"},
    "srdf": {"srdf": ROBOT.srdf + "\n"},
    "limit": {"joints": {name: dataclasses.replace(joint, upper=0.1) for name, joint in ROBOT.joints.items()}},
    "meshes": {"mesh_directory": ROOT},
    "hull": {"hulls": {}},
    "parts": {"parts": {}},
}


@pytest.mark.parametrize("change", DIFFERENT.values(), ids=DIFFERENT.keys())
def test_a_robot_that_differs_has_another_digest(change: dict[str, Any]) -> None:
    assert digest(dataclasses.replace(ROBOT, **change), 1000) != digest(ROBOT, 1000)
    assert digest(ROBOT, 1001) != digest(ROBOT, 1000)
