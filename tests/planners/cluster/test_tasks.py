from __future__ import annotations

import asyncio
import pickle
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from planners.cluster import contract, tasks
from planners.cluster.messages import Missing, SceneKey
from planners.cluster.tasks import MAX_ROBOTS, MAX_SCENES, TASK_PREFIX, Bench
from planners.pool import PlannerPool
from planners.problem import Answer, MoveItErrorCode, PlanningFailure, Request
from planners.scene import EMPTY_SCENE, Box, Pose, Scene, SceneObject
from tests.helpers.requests import EASY

distributed = pytest.importorskip("distributed", reason="the extra [dask] is not installed")

OBJECTS = tuple(SceneObject(f"box {i}", ((Box((0.1, 0.1, 0.1)), Pose()),)) for i in range(3))
DONE = PlanningFailure(MoveItErrorCode.FAILURE, "done")
ADDRESS = "tcp://worker:1"


class Pool:
    """Answers when it is told to; takes the place of a PlannerPool."""

    def __init__(self, *arguments: Any) -> None:
        self.arguments = arguments
        self.closed = False
        self.asked: list[tuple[Request, Scene]] = []
        self.given_up = False
        self.answer: asyncio.Event = asyncio.Event()
        self.answer.set()

    async def start(self) -> None:
        if Pools.fail:
            raise OSError("no process")

    async def wait_ready(self, timeout_s: float) -> str | None:
        return None

    async def close(self) -> None:
        self.closed = True

    async def ask(self, request: Request, scene: Scene) -> Answer:
        self.asked.append((request, scene))
        try:
            await self.answer.wait()
        except asyncio.CancelledError:
            self.given_up = True
            raise
        return DONE


class Pools:
    fail = False
    made: list[Pool] = []  # noqa: RUF012 - emptied for each test

    @classmethod
    def make(cls, *arguments: Any) -> Pool:
        cls.made.append(Pool(*arguments))
        return cls.made[-1]


class DaskWorker:
    """What the tasks look at in a Dask worker."""

    def __init__(self) -> None:
        self.address = ADDRESS
        running = {TASK_PREFIX + "token": SimpleNamespace(state="executing")}
        self.state = SimpleNamespace(nthreads=3, tasks=running)


@pytest.fixture(autouse=True)
def dask_worker(monkeypatch: pytest.MonkeyPatch) -> Iterator[DaskWorker]:
    worker = DaskWorker()
    monkeypatch.setattr(distributed, "get_worker", lambda: worker)
    monkeypatch.setattr(tasks, "PlannerPool", Pools.make)
    Pools.fail = False
    yield worker
    Pools.made.clear()
    tasks._benches.clear()


def bench() -> Bench:
    return Bench(cast("PlannerPool", Pool()))


def bring(to: Bench, key: SceneKey, scene: Scene, upload: str = "upload") -> None:
    to.begin(upload, scene)
    to.finish(upload, key)


def test_the_empty_scene_is_always_there() -> None:
    assert bench().scene(SceneKey("server", EMPTY_SCENE.version)) is EMPTY_SCENE


def test_a_scene_comes_in_parts() -> None:
    made = bench()
    made.begin("upload", Scene(7, link_padding_m={"link": 0.1}))
    for each in OBJECTS:
        assert made.scene(SceneKey("server", 7)) is None
        made.extend("upload", (each,))
    made.finish("upload", SceneKey("server", 7))
    scene = made.scene(SceneKey("server", 7))
    assert scene is not None
    assert scene.objects == OBJECTS
    assert scene.link_padding_m == {"link": 0.1}


def test_scenes_of_two_servers_with_one_number_are_two() -> None:
    made = bench()
    for server in ("one", "other"):
        bring(made, SceneKey(server, 1), Scene(1))
    scenes = [made.scene(SceneKey(server, 1)) for server in ("one", "other")]
    versions = {scene.version for scene in scenes if scene is not None}
    assert len(versions) == 2
    assert EMPTY_SCENE.version not in versions


def test_two_uploads_of_a_scene_at_the_same_time_do_not_mix() -> None:
    made = bench()
    key = SceneKey("server", 1)
    for upload in ("first", "second"):
        made.begin(upload, Scene(1))
    for each in OBJECTS:
        for upload in ("first", "second"):
            made.extend(upload, (each,))
    for upload in ("first", "second"):
        made.finish(upload, key)
        scene = made.scene(key)
        assert scene is not None
        assert scene.objects == OBJECTS


def test_the_scene_that_was_longest_unused_goes_first() -> None:
    made = bench()
    keys = [SceneKey("server", 1 + i) for i in range(MAX_SCENES + 1)]
    for key in keys[:-1]:
        bring(made, key, Scene(key.version))
    made.scene(keys[0])
    bring(made, keys[-1], Scene(keys[-1].version))
    assert [made.scene(key) is not None for key in keys] == [True, False, *[True] * (MAX_SCENES - 1)]


def test_uploads_that_never_end_are_given_up_and_harm_nothing() -> None:
    made = bench()
    for i in range(MAX_SCENES + 1):
        made.begin(f"upload {i}", Scene(1))
    made.extend("upload 0", OBJECTS)
    made.finish("upload 0", SceneKey("server", 1))
    assert made.scene(SceneKey("server", 1)) is None
    assert len(made._coming) == MAX_SCENES


async def test_it_tells_the_contract() -> None:
    assert await tasks.agree() == contract.contract()


async def test_a_robot_gets_processes_once_as_many_as_the_worker_has_threads(dask_worker: DaskWorker) -> None:
    for _ in range(2):
        assert await tasks.take_robot("digest", pickle.dumps("robot"), 1000, dask_worker) is None
    assert [pool.arguments for pool in Pools.made] == [("robot", 3, 1000)]


async def test_processes_that_cannot_be_started_are_tried_again(dask_worker: DaskWorker) -> None:
    Pools.fail = True
    with pytest.raises(OSError, match="no process"):
        await tasks.take_robot("digest", pickle.dumps("robot"), 1000, dask_worker)
    Pools.fail = False
    assert await tasks.take_robot("digest", pickle.dumps("robot"), 1000, dask_worker) is None
    assert len(Pools.made) == 2


async def test_the_robot_that_was_longest_unused_loses_its_processes(dask_worker: DaskWorker) -> None:
    for i in range(MAX_ROBOTS + 1):
        await tasks.take_robot(f"digest {i}", pickle.dumps(i), 1000, dask_worker)
    assert [pool.closed for pool in Pools.made] == [True, *[False] * MAX_ROBOTS]


async def ask(version: int = EMPTY_SCENE.version) -> Answer | Missing:
    return await tasks.answer("token", "digest", pickle.dumps(SceneKey("server", version)), pickle.dumps(EASY))


async def test_a_worker_without_the_robot_says_so() -> None:
    assert await ask() == Missing(ADDRESS, robot=True)


async def test_a_worker_without_the_scene_says_so_until_it_was_sent(dask_worker: DaskWorker) -> None:
    await tasks.take_robot("digest", pickle.dumps("robot"), 1000, dask_worker)
    assert await ask(5) == Missing(ADDRESS, robot=False)
    for part in (Scene(5), OBJECTS, SceneKey("server", 5)):
        await tasks.take_scene_part("digest", "upload", pickle.dumps(part))
    assert await ask(5) == DONE
    ((request, scene),) = Pools.made[0].asked
    assert (request, scene.objects) == (EASY, OBJECTS)


async def test_a_part_of_a_scene_for_a_robot_that_is_gone_harms_nothing() -> None:
    await tasks.take_scene_part("digest", "upload", pickle.dumps(Scene(5)))


@pytest.mark.parametrize("left", [{}, {TASK_PREFIX + "token": SimpleNamespace(state="cancelled")}])
async def test_a_task_that_is_taken_back_stops_the_planner(dask_worker: DaskWorker, left: dict[str, Any]) -> None:
    await tasks.take_robot("digest", pickle.dumps("robot"), 1000, dask_worker)
    pool = Pools.made[0]
    pool.answer.clear()
    asking = asyncio.create_task(ask())
    await asyncio.sleep(0.03)
    assert not asking.done()
    dask_worker.state.tasks = left
    answer = await asyncio.wait_for(asking, 1.0)
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.PREEMPTED
    await asyncio.sleep(0)
    assert pool.given_up


async def test_a_worker_that_closes_stops_the_planner(dask_worker: DaskWorker) -> None:
    await tasks.take_robot("digest", pickle.dumps("robot"), 1000, dask_worker)
    pool = Pools.made[0]
    pool.answer.clear()
    asking = asyncio.create_task(ask())
    await asyncio.sleep(0)
    asking.cancel()
    await asyncio.wait([asking])
    await asyncio.sleep(0)
    assert pool.given_up
