"""Planners that several servers share: fair turns, scenes kept apart, and an end of the host."""

import asyncio
import dataclasses
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np
import pytest
import pytest_asyncio

from harness.waiting import TIMEOUT_S, given_up, until
from planners import shared_pool
from planners.messages import PART_BYTES
from planners.problem import Answer, MoveItErrorCode, Plan
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


@pytest.fixture
def address(farm: Farm, tmp_path: Path) -> Path:
    """The address of a host whose workers load at once."""
    farm.load_s = 0.0
    return tmp_path / "planners"


@pytest_asyncio.fixture
async def servers(address: Path) -> AsyncIterator[Servers]:
    """The planners of two servers."""
    async with running_host(address):
        both = SharedPlanners(address), SharedPlanners(address)
        for each in both:
            await each.start()
        yield both
        for each in both:
            await each.close()


async def under_way(server: SharedPlanners, farm: Farm) -> asyncio.Task[Answer]:
    """Have a search be made that never ends; it has begun then."""
    before = sum(len(worker.asked) for worker in farm.workers)
    asking = asyncio.create_task(server.ask(dataclasses.replace(EASY, group=DEAF, allowed_time_s=3600.0)))
    await until(lambda: sum(len(worker.asked) for worker in farm.workers) > before)
    return asking


async def test_both_servers_get_answers_in_a_bounded_time_and_know_the_processes_behind_them(servers: Servers) -> None:
    hour = dataclasses.replace(EASY, allowed_time_s=3600.0)
    assert bounded(hour) == dataclasses.replace(EASY, allowed_time_s=LONGEST_PLANNING_S)
    assert bounded(EASY) == EASY
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


async def test_a_scene_given_up_half_way_is_not_mixed_with_the_one_before(servers: Servers) -> None:
    mesh = Mesh(np.zeros((PART_BYTES // 24, 3)), np.zeros((0, 3), dtype=np.int32))
    large = Scene(2, tuple(SceneObject(str(i), ((mesh, Pose()),)) for i in range(4)))
    assert await servers[0].ask(STATE, Scene(1)) == SOUND
    sending = asyncio.create_task(servers[0].ask(STATE, large))
    await asyncio.sleep(0)
    await given_up(sending)
    assert await servers[0].ask(STATE, Scene(1)) == SOUND
    assert await servers[0].ask(STATE, large) == TOUCHING


async def test_a_planner_that_dies_costs_one_server_one_goal_and_a_cancelled_request_gives_its_planner_to_the_next(
    servers: Servers, farm: Farm, monkeypatch: pytest.MonkeyPatch
) -> None:
    crash = dataclasses.replace(EASY, group=CRASHES)
    failed, done = await asyncio.gather(servers[0].ask(crash), servers[1].ask(STATE))
    assert (failed.code, done) == (MoveItErrorCode.CRASH, SOUND)
    assert isinstance(await servers[0].ask(EASY), Plan)
    monkeypatch.setattr(shared_pool, "LONGEST_PLANNING_S", 3600.0)
    await given_up(await under_way(servers[0], farm))
    assert isinstance(await asyncio.wait_for(servers[1].ask(EASY), TIMEOUT_S), Plan)


async def test_a_request_that_fails_at_the_host_or_is_too_large_for_a_message_or_finds_no_answer_is_refused(
    servers: Servers, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert await servers[0].ask(STATE) == SOUND
    with monkeypatch.context() as patch:
        patch.setattr(FakeWorker, "ask", lambda *_: 1 / 0)
        failed = await servers[0].ask(STATE)
    assert failed.message == "the planners failed: ZeroDivisionError: division by zero"
    with monkeypatch.context() as patch:
        patch.setattr(channel, "MAX_MESSAGE_BYTES", 8)
        refused = await servers[0].ask(STATE)
    assert "the problem cannot be given to a planner" in refused.message
    monkeypatch.setattr(shared_pool, "ANSWER_TIMEOUT_S", 0.0)
    late = await servers[0].ask(dataclasses.replace(EASY, group=DEAF))
    assert late.code is MoveItErrorCode.TIMED_OUT


async def test_a_robot_that_the_host_cannot_load_is_told(farm: Farm, address: Path) -> None:
    farm.refusal = "no link"
    server = SharedPlanners(address)
    async with running_host(address):
        await server.start()
        assert await server.wait_until_loaded() == "no link"
        await server.close()


async def test_a_host_that_ends_answers_requests_and_another_takes_over(farm: Farm, address: Path) -> None:
    server = SharedPlanners(address)
    await server.start()
    async with running_host(address):
        assert await server.ask(STATE) == SOUND
        asking = await under_way(server, farm)
    assert ((await asking).code, server.pids) == (MoveItErrorCode.CRASH, ())
    async with running_host(address):
        assert await server.ask(STATE) == SOUND
    await server.close()
