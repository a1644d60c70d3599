"""Planners that several servers share: fair turns, scenes kept apart, and an end of the host."""

import asyncio
import dataclasses
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import numpy as np
import pytest
import pytest_asyncio

from harness.waiting import TIMEOUT_S, given_up, until
from planners import shared_pool
from planners.messages import PART_BYTES
from planners.problem import Answer, MoveItErrorCode, Plan, PlanningFailure
from planners.scene import Box, Mesh, Pose, Scene, SceneObject
from planners.shared_pool import LONGEST_PLANNING_S, PlannerHost, SharedPlanners, bounded
from robot import channel
from tests.helpers.fake_workers import CRASHES, DEAF, SOUND, TOUCHING, FakeWorker, Farm
from tests.helpers.motions import EASY, STATE
from tests.helpers.robots import so101

Servers = tuple[SharedPlanners, SharedPlanners]


@asynccontextmanager
async def running_host(address: Path) -> AsyncIterator[None]:
    """A host with one planner for motions and one for questions, all in this process."""
    host = PlannerHost(so101(), address, servers=2, active=1, questions=1)
    serving = asyncio.create_task(host.run())
    try:
        yield
    finally:
        serving.cancel()
        await asyncio.wait([serving])


@pytest_asyncio.fixture
async def servers(farm: Farm, tmp_path: Path) -> AsyncIterator[Servers]:
    """The planners of two servers."""
    farm.load_s = 0.0
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(running_host(tmp_path / "planners"))
        both = SharedPlanners(tmp_path / "planners"), SharedPlanners(tmp_path / "planners")
        for each in both:
            await each.start()
            stack.push_async_callback(each.close)
        yield both


async def test_both_servers_get_answers_and_know_the_processes_behind_them(servers: Servers) -> None:
    for each in servers:
        assert await each.wait_until_loaded() is None
        assert isinstance(await each.ask(EASY), Plan)
        assert await each.ask(STATE) == SOUND
        assert each.pids == servers[0].pids
        assert len(each.pids) == each.loaded_count == each.idle_count > 0


async def test_scenes_of_two_servers_are_kept_apart_though_their_numbers_are_the_same(servers: Servers) -> None:
    box = SceneObject("box", ((Box((0.2, 0.2, 0.5)), Pose((0.3, 0.0, 0.1))),))
    blocked, free = Scene(version=7, objects=(box,)), Scene(version=7)
    for _ in range(2):
        answers = await asyncio.gather(servers[0].ask(STATE, blocked), servers[1].ask(STATE, free))
        assert answers == [TOUCHING, SOUND]


async def test_a_server_with_many_goals_leaves_every_other_turn_to_one_with_a_single_goal(servers: Servers) -> None:
    many = [asyncio.create_task(servers[0].ask(EASY)) for _ in range(6)]
    await asyncio.sleep(0)
    assert isinstance(await servers[1].ask(EASY), Plan)
    assert sum(task.done() for task in many) <= 2
    assert all(isinstance(answer, Plan) for answer in await asyncio.gather(*many))


async def test_a_cancelled_request_gives_its_planner_to_the_next_server(
    servers: Servers, farm: Farm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shared_pool, "LONGEST_PLANNING_S", 3600.0)
    await given_up(await under_way(servers[0], farm))
    assert isinstance(await asyncio.wait_for(servers[1].ask(EASY), TIMEOUT_S), Plan)


async def test_a_scene_given_up_half_way_is_not_mixed_with_the_one_before(servers: Servers) -> None:
    meshes = [Mesh(np.zeros((PART_BYTES // 24, 3)), np.zeros((0, 3), dtype=np.int32)) for _ in range(4)]
    large = Scene(2, tuple(SceneObject(str(i), ((mesh, Pose()),)) for i, mesh in enumerate(meshes)))
    assert await servers[0].ask(STATE, Scene(1)) == SOUND
    sending = asyncio.create_task(servers[0].ask(STATE, large))
    await asyncio.sleep(0)
    await given_up(sending)
    assert await servers[0].ask(STATE, Scene(1)) == SOUND
    assert await servers[0].ask(STATE, large) == TOUCHING


async def test_a_planner_that_dies_costs_one_server_one_goal(servers: Servers) -> None:
    crash = dataclasses.replace(EASY, group=CRASHES)
    failed, done = await asyncio.gather(servers[0].ask(crash), servers[1].ask(STATE))
    assert isinstance(failed, PlanningFailure)
    assert failed.code is MoveItErrorCode.CRASH
    assert done == SOUND
    assert isinstance(await servers[0].ask(EASY), Plan)


async def test_a_request_that_fails_at_the_host_is_a_crash(servers: Servers, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeWorker, "ask", lambda *_: 1 / 0)
    answer = await servers[0].ask(STATE)
    assert isinstance(answer, PlanningFailure)
    assert answer.message == "the planners failed: ZeroDivisionError: division by zero"


async def test_a_request_too_large_for_a_message_is_refused(servers: Servers, monkeypatch: pytest.MonkeyPatch) -> None:
    assert await servers[0].ask(STATE) == SOUND
    with monkeypatch.context() as patch:
        patch.setattr(channel, "MAX_MESSAGE_BYTES", 8)
        answer = await servers[0].ask(STATE)
    assert isinstance(answer, PlanningFailure)
    assert "the problem cannot be given to a planner" in answer.message


async def test_a_host_that_does_not_answer_is_given_up(servers: Servers, monkeypatch: pytest.MonkeyPatch) -> None:
    assert await servers[0].ask(STATE) == SOUND
    monkeypatch.setattr(shared_pool, "ANSWER_TIMEOUT_S", 0.0)
    answer = await servers[0].ask(dataclasses.replace(EASY, group=DEAF))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.TIMED_OUT


async def test_a_robot_that_the_host_cannot_load_is_told(farm: Farm, tmp_path: Path) -> None:
    farm.load_s, farm.refusal = 0.0, "no link"
    server = SharedPlanners(tmp_path / "planners")
    async with running_host(tmp_path / "planners"):
        await server.start()
        assert await server.wait_until_loaded() == "no link"
        await server.close()


async def test_nobody_plans_longer_than_others_can_wait_for() -> None:
    hour = dataclasses.replace(EASY, allowed_time_s=3600.0)
    assert bounded(hour) == dataclasses.replace(EASY, allowed_time_s=LONGEST_PLANNING_S)
    assert bounded(EASY) == EASY


async def test_a_host_that_ends_answers_what_is_under_way_and_another_takes_its_place(
    farm: Farm, tmp_path: Path
) -> None:
    farm.load_s = 0.0
    server = SharedPlanners(tmp_path / "planners")
    await server.start()
    async with running_host(tmp_path / "planners"):
        assert await server.ask(STATE) == SOUND
        asking = await under_way(server, farm)
    failed = await asking
    assert isinstance(failed, PlanningFailure)
    assert (failed.code, server.pids) == (MoveItErrorCode.CRASH, ())
    async with running_host(tmp_path / "planners"):
        assert await server.ask(STATE) == SOUND
    await server.close()


async def under_way(server: SharedPlanners, farm: Farm) -> asyncio.Task[Answer]:
    """Have a search be made that never ends; it has begun then."""
    before = sum(len(worker.asked) for worker in farm.workers)
    asking = asyncio.create_task(server.ask(dataclasses.replace(EASY, group=DEAF, allowed_time_s=3600.0)))
    await until(lambda: sum(len(worker.asked) for worker in farm.workers) > before)
    return asking
