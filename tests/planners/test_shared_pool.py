"""Planners that several servers share: fair turns, scenes kept apart, and an end of the host."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import AsyncIterator, Awaitable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from planners import pool as pool_module
from planners import pool_host
from planners.pool_host import LONGEST_PLANNING_S, PlannerHost, bounded
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, StateAnswer
from planners.scene import Box, Pose, Scene, SceneObject
from planners.shared_pool import SharedPlanners
from tests.helpers import broken_planner
from tests.helpers.motions import EASY, REQUESTS, STATE, broken
from tests.helpers.robots import so101
from tests.planners.test_pool import MEMORY_LIMIT_BYTES, ROOT

SOON_S = 30.0

pytestmark = pytest.mark.asyncio(loop_scope="module")


@asynccontextmanager
async def running_host(address: Path) -> AsyncIterator[asyncio.Task[None]]:
    """A host with one planner for motions and one for questions."""
    host = PlannerHost(so101(), address, servers=2, active=1, questions=1, memory_limit_bytes=MEMORY_LIMIT_BYTES)
    serving = asyncio.create_task(host.run())
    try:
        yield serving
    finally:
        serving.cancel()
        await asyncio.wait([serving])


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def address(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Path]:
    path = tmp_path_factory.mktemp("host") / "planners"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT))
        patch.setattr(pool_module, "WORKER_MODULE", "tests.helpers.broken_planner")
        async with running_host(path):
            yield path


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def servers(address: Path) -> AsyncIterator[tuple[SharedPlanners, SharedPlanners]]:
    """The planners of two servers."""
    async with AsyncExitStack() as stack:
        both = SharedPlanners(so101(), address), SharedPlanners(so101(), address)
        for each in both:
            await each.start()
            stack.push_async_callback(each.close)
        yield both


Servers = tuple[SharedPlanners, SharedPlanners]


async def soon(asking: Awaitable[Any]) -> Any:
    """What comes within a time that is long even on a busy machine."""
    return await asyncio.wait_for(asking, SOON_S)


async def test_every_request_gets_its_kind_of_answer(servers: Servers) -> None:
    for request, kind in REQUESTS:
        assert isinstance(await soon(servers[0].ask(request)), kind)


async def test_no_server_gets_a_second_planner_for_a_hard_problem(servers: Servers) -> None:
    group = broken_planner.racers(broken_planner.NONE, broken_planner.PLAN)
    # Long enough for the other planner to load, and to be asked as well.
    answer = await soon(servers[0].ask(dataclasses.replace(EASY, group=group, allowed_time_s=3.0)))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.TIMED_OUT


async def test_each_server_knows_the_processes_behind_it(servers: Servers) -> None:
    assert await soon(servers[0].ask(EASY))
    assert len(servers[0].pids) == 2
    assert servers[0].pids == servers[1].pids


async def test_scenes_of_two_servers_are_kept_apart_though_their_numbers_are_the_same(servers: Servers) -> None:
    box = SceneObject("box", ((Box((0.2, 0.2, 0.5)), Pose((0.3, 0.0, 0.1))),))
    blocked, free = Scene(version=7, objects=(box,)), Scene(version=7)
    for _ in range(2):
        first, second = await soon(asyncio.gather(servers[0].ask(STATE, blocked), servers[1].ask(STATE, free)))
        assert isinstance(first, StateAnswer)
        assert isinstance(second, StateAnswer)
        assert (first.valid, second.valid) == (False, True)


async def test_a_server_with_many_goals_leaves_every_other_turn_to_one_with_a_single_goal(servers: Servers) -> None:
    many = [asyncio.create_task(servers[0].ask(EASY)) for _ in range(6)]
    await asyncio.sleep(0)
    assert isinstance(await soon(servers[1].ask(EASY)), Plan)
    assert sum(task.done() for task in many) <= 2
    assert all(isinstance(answer, Plan) for answer in await soon(asyncio.gather(*many)))


async def test_a_cancelled_request_gives_its_planner_to_the_next_server(
    servers: Servers, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool_host, "LONGEST_PLANNING_S", 3600.0)
    # They have loaded then, and the next request is under way at once.
    assert isinstance(await soon(servers[0].ask(EASY)), Plan)
    long = asyncio.create_task(servers[0].ask(broken(broken_planner.DEAF, allowed_time_s=3600.0)))
    await asyncio.sleep(0.2)
    long.cancel()
    assert isinstance(await soon(servers[1].ask(EASY)), Plan)


async def test_a_planner_that_dies_costs_one_server_one_goal(servers: Servers) -> None:
    failed, done = await soon(asyncio.gather(servers[0].ask(broken(broken_planner.SEGFAULT)), servers[1].ask(STATE)))
    assert isinstance(failed, PlanningFailure)
    assert failed.code is MoveItErrorCode.CRASH
    assert isinstance(done, StateAnswer)
    assert isinstance(await soon(servers[0].ask(EASY)), Plan)


async def test_planners_that_others_have_as_well_plan_nothing_in_the_background(servers: Servers) -> None:
    assert await soon(servers[0].ask_in_background(EASY)) is None


async def test_nobody_plans_longer_than_others_can_wait_for() -> None:
    hour = dataclasses.replace(EASY, allowed_time_s=3600.0)
    assert bounded(hour) == dataclasses.replace(EASY, allowed_time_s=LONGEST_PLANNING_S)
    assert bounded(EASY) == EASY


async def test_a_host_that_ends_answers_what_is_under_way_and_another_takes_its_place(tmp_path: Path) -> None:
    server = SharedPlanners(so101(), tmp_path / "planners")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT))
        patch.setattr(pool_module, "WORKER_MODULE", "tests.helpers.broken_planner")
        await server.start()
        async with running_host(tmp_path / "planners"):
            assert isinstance(await soon(server.ask(EASY)), Plan)
            asking = asyncio.create_task(server.ask(broken(broken_planner.DEAF)))
            await asyncio.sleep(0.2)
        failed = await soon(asking)
        assert isinstance(failed, PlanningFailure)
        assert (failed.code, server.pids) == (MoveItErrorCode.CRASH, ())
        async with running_host(tmp_path / "planners"):
            assert isinstance(await soon(server.ask(EASY)), Plan)
        await server.close()
