from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import numpy as np
import pytest
import pytest_asyncio

from planners.cluster import cluster as cluster_module
from planners.cluster import link as link_module
from planners.cluster.cluster import Cluster, TlsFiles
from planners.pool import MEMORY_LIMIT_BYTES, PlannerPool
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, RecheckAnswer, RecheckQuestion
from planners.scene import Box, Pose, Scene, SceneObject
from robot.description import model
from tests.helpers.certificates import make_pair
from tests.helpers.dask_cluster import DaskCluster, free_port
from tests.helpers.requests import EASY, LONG, START

pytest.importorskip("distributed", reason="the extra [dask] is not installed")

# Real processes, which load for seconds: one cluster and one pool serve the tests of this file, in their order.
pytestmark = pytest.mark.asyncio(loop_scope="module")

# About the turn of the shoulder that EASY asks for: the first lets it through and the second does not.
FAR_BOX = Scene(1, (SceneObject("box", ((Box((0.1, 0.1, 0.1)), Pose()),), Pose((2.0, 0.0, 0.0))),))
NEAR_BOX = Scene(2, (SceneObject("box", ((Box((0.6, 0.6, 0.6)), Pose()),), Pose((0.3, 0.2, 0.3))),))

# Interpreters that import Dask and load planners take three seconds on a quiet machine.
START_TIMEOUT_S = 60.0

# A search that a worker has in hand for so long: enough to notice, on a loaded machine, that it is lost.
SEARCH_S = 1.5
SEARCH = dataclasses.replace(LONG, allowed_time_s=SEARCH_S)


@pytest.fixture(scope="module")
def dask() -> Iterator[DaskCluster]:
    made = DaskCluster()
    made.start_scheduler()
    for _ in range(2):
        made.start_worker()
    yield made
    made.close()


@pytest.fixture(scope="module", autouse=True)
def _short_pauses() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cluster_module, "WATCH_PERIOD_S", 0.1)
        patch.setattr(cluster_module, "RECONNECT_PAUSE_S", 0.1)
        yield


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def pool() -> AsyncIterator[PlannerPool]:
    made = PlannerPool(model.builtin())
    await made.start()
    yield made
    await made.close()


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def cluster(dask: DaskCluster, pool: PlannerPool) -> AsyncIterator[Cluster]:
    made = Cluster(dask.address, model.builtin(), MEMORY_LIMIT_BYTES, pool)
    made.start()
    await joined(made, 2)
    yield made
    await made.close()


async def joined(cluster: Cluster, count: int) -> None:
    async with asyncio.timeout(START_TIMEOUT_S):
        while len(cluster._workers) != count:
            await asyncio.sleep(0.02)


async def told(text: str, caplog: pytest.LogCaptureFixture) -> None:
    async with asyncio.timeout(START_TIMEOUT_S):
        while text not in caplog.text:
            await asyncio.sleep(0.02)


def assert_true(answers: list[Plan | PlanningFailure]) -> None:
    """What a search that has no end may be answered with: the best it has found, or that time was over."""
    for answer in answers:
        assert isinstance(answer, Plan) or answer.code is MoveItErrorCode.TIMED_OUT, answer


async def test_the_same_problem_has_the_same_valid_plan_here_and_there(cluster: Cluster, pool: PlannerPool) -> None:
    here = await pool.ask(EASY)
    there = await cluster._workers[0].ask(EASY, Scene())
    assert isinstance(here, Plan)
    assert isinstance(there, Plan)
    np.testing.assert_array_equal(here.trajectory.positions_rad, there.trajectory.positions_rad)
    checked = await pool.ask(RecheckQuestion("arm", there.trajectory, START, 0.0))
    assert checked == RecheckAnswer(None)


async def test_a_scene_counts_there_and_is_sent_once_to_each_worker(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    supplied = []
    supply = link_module.Link.supply
    monkeypatch.setattr(link_module.Link, "supply", lambda *args: supplied.append(args) or supply(*args))
    far = cluster._workers[0]
    for _ in range(4):
        assert isinstance(await far.ask(EASY, FAR_BOX), Plan)
    answers = await asyncio.gather(*(worker.ask(EASY, NEAR_BOX) for worker in cluster._workers))
    assert {type(answer) for answer in answers} == {PlanningFailure}
    assert len(supplied) <= 4


async def test_motions_beyond_the_local_ones_are_planned_on_the_cluster(cluster: Cluster, pool: PlannerPool) -> None:
    long = [asyncio.create_task(pool.ask(LONG)) for _ in range(3)]
    await asyncio.sleep(0.3)
    assert pool.idle_count == 1  # the spare, which answers questions
    fourth = asyncio.create_task(pool.ask(EASY))
    await asyncio.sleep(0.1)
    assert not fourth.done()
    # Taken back, a search ends at once and its worker is free for the next: one of them is local.
    for task in long[1:]:
        task.cancel()
    assert isinstance(await asyncio.wait_for(fourth, 2.0), Plan)
    assert isinstance(await asyncio.wait_for(pool.ask(EASY), 2.0), Plan)
    long[0].cancel()
    await asyncio.wait(long)


async def test_what_runs_on_a_worker_that_dies_is_planned_by_another(
    cluster: Cluster, dask: DaskCluster, pool: PlannerPool
) -> None:
    long = asyncio.create_task(pool.ask(LONG))
    await asyncio.sleep(0.1)
    searching = [asyncio.create_task(pool.ask(SEARCH)) for _ in range(2)]
    await asyncio.sleep(0.3)
    assert not any(task.done() for task in searching)
    await asyncio.to_thread(dask.kill_worker, 0)
    assert_true(await asyncio.wait_for(asyncio.gather(*searching), SEARCH_S + 1.5))
    await joined(cluster, 1)
    long.cancel()


async def test_a_scheduler_that_dies_costs_no_goal_and_is_found_again(
    cluster: Cluster, dask: DaskCluster, pool: PlannerPool, caplog: pytest.LogCaptureFixture
) -> None:
    searching = [asyncio.create_task(pool.ask(SEARCH)) for _ in range(2)]
    await asyncio.sleep(0.3)
    assert not any(task.done() for task in searching)
    await asyncio.to_thread(dask.kill_scheduler)
    assert_true(await asyncio.wait_for(asyncio.gather(*searching), 2 * SEARCH_S + 1.5))
    await told("planning goes on here", caplog)
    await joined(cluster, 0)
    assert isinstance(await pool.ask(EASY), Plan)
    dask.start_scheduler()
    dask.start_worker()
    await joined(cluster, 1)
    assert isinstance(await cluster._workers[0].ask(EASY, Scene()), Plan)


async def test_a_worker_of_another_armbridge_is_left_out_and_told(
    cluster: Cluster, dask: DaskCluster, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_module, "contract", lambda: "0.0.9 (planners 01234567)")
    alone = PlannerPool(model.builtin())
    other = Cluster(dask.address, model.builtin(), MEMORY_LIMIT_BYTES, alone)
    other.start()
    await told("this server 0.0.9 (planners 01234567): install the same on both", caplog)
    await told("it has no worker that can plan for this server", caplog)
    await other.close()
    assert len(cluster._workers) == 1


async def test_without_a_scheduler_at_the_start_planning_goes_on_here(
    pool: PlannerPool, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_TIMEOUT_S", 0.2)
    nowhere = Cluster(f"tcp://127.0.0.1:{free_port()}", model.builtin(), MEMORY_LIMIT_BYTES, pool)
    nowhere.start()
    await told("planning goes on here", caplog)
    await asyncio.sleep(0.5)
    assert caplog.text.count("planning goes on here") == 1
    assert isinstance(await pool.ask(EASY), Plan)
    await nowhere.close()


async def test_a_scheduler_with_certificates_takes_in_who_has_the_right_ones(
    tmp_path: Path, pool: PlannerPool, caplog: pytest.LogCaptureFixture
) -> None:
    right, wrong = (make_pair(tmp_path / name) for name in ("right", "wrong"))
    files = ("--tls-ca-file", right.certificate, "--tls-cert", right.certificate, "--tls-key", right.key)
    dask = DaskCluster(*map(str, files), scheme="tls")
    dask.start_scheduler()
    try:
        for pair, said in ((right, "it has no worker that can plan"), (wrong, "SSL")):
            tls = TlsFiles(right.certificate, pair.certificate, pair.key)
            cluster = Cluster(dask.address, model.builtin(), MEMORY_LIMIT_BYTES, pool, tls)
            cluster.start()
            await told(said, caplog)
            await cluster.close()
    finally:
        dask.close()
