from __future__ import annotations

import asyncio
import dataclasses
import math
import os
import signal
import time
from collections.abc import AsyncIterator

import numpy as np
import pytest
import pytest_asyncio
from hypothesis import given
from hypothesis import strategies as st

from planners import worker_process
from planners.budget import Deadline
from planners.problem import PlanningFailure, StateAnswer
from planners.scene import Box, Mesh, Pose, Scene, SceneObject
from planners.worker_process import (
    MAX_ALLOWED_TIME_S,
    OBJECT_BYTES,
    PART_BYTES,
    WorkerProcess,
    allowed_time_s,
    parts,
    timeout_at,
)
from robot.channel import MAX_MESSAGE_BYTES
from robot.description import model
from tests.helpers.requests import EASY, LONG, REQUESTS, STATE

TWINS = (SceneObject("twin", ((Box((0.1, 0.1, 0.1)), Pose((2.0, 0.0, 0.0))),)),) * 2


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def worker() -> AsyncIterator[WorkerProcess]:
    loaded = asyncio.Event()
    made = WorkerProcess(model.builtin(), 1 << 30, lambda _worker, _refusal: loaded.set(), lambda _worker: None)
    await made.start()
    await asyncio.wait_for(loaded.wait(), 60.0)
    yield made
    await made.kill()


in_one_loop = pytest.mark.asyncio(loop_scope="module")


def boxes(count: int) -> tuple[SceneObject, ...]:
    return tuple(
        SceneObject(f"box {i}", ((Box((0.01, 0.01, 0.01)), Pose()),), Pose((2.0 + 0.02 * i, 0.0, 0.0)))
        for i in range(count)
    )


@in_one_loop
async def test_a_scene_is_sent_again_only_when_its_version_is_another(worker: WorkerProcess) -> None:
    assert isinstance(await worker.ask(STATE, Scene(1, TWINS)), PlanningFailure)
    # The same version says that nothing has changed; the worker still holds what it refused.
    assert isinstance(await worker.ask(STATE, Scene(1)), PlanningFailure)
    assert isinstance(await worker.ask(STATE, Scene(2)), StateAnswer)
    assert worker.has(Scene(2))
    assert not worker.has(Scene(1))


@in_one_loop
async def test_a_scene_given_up_half_way_is_sent_anew(worker: WorkerProcess) -> None:
    large = Scene(3, boxes(600))
    asking = asyncio.create_task(worker.ask(STATE, large))
    await asyncio.sleep(0)
    asking.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asking
    await worker.cancel()
    assert not worker.has(large)
    # Objects that came twice would be refused as duplicates.
    assert isinstance(await worker.ask(STATE, large), StateAnswer)


@in_one_loop
async def test_what_no_message_can_hold_is_refused_and_harms_nothing(worker: WorkerProcess) -> None:
    huge = Mesh(np.zeros((MAX_MESSAGE_BYTES // 24 + 1, 3)), np.zeros((0, 3), dtype=np.int32))
    answer = await worker.ask(STATE, Scene(4, (SceneObject("huge", ((huge, Pose()),)),)))
    assert isinstance(answer, PlanningFailure)
    assert str(MAX_MESSAGE_BYTES) in answer.message
    assert isinstance(await worker.ask(STATE, Scene(5)), StateAnswer)


@in_one_loop
async def test_a_cancelled_worker_that_waits_for_a_core_is_waited_for(
    worker: WorkerProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_process, "CANCEL_TIMEOUT_S", 0.02)
    monkeypatch.setattr(worker_process, "read_run_delay_s", lambda _pid: time.monotonic())
    asking = asyncio.create_task(worker.ask(LONG, Scene(6)))
    await asyncio.sleep(0.05)
    os.kill(worker.pid, signal.SIGSTOP)
    cancelling = asyncio.create_task(worker.cancel())
    await asyncio.sleep(0.2)
    os.kill(worker.pid, signal.SIGCONT)
    await asyncio.gather(cancelling, asking)
    assert worker.usable


async def test_what_is_in_work_is_ended_once_its_deadline_has_passed() -> None:
    with pytest.raises(TimeoutError):
        async with timeout_at(Deadline(0.01, lambda: 0.0)):
            await asyncio.sleep(10.0)


async def test_what_is_in_work_is_not_ended_while_its_process_waits_for_a_core() -> None:
    async with timeout_at(Deadline(0.01, time.monotonic)):
        await asyncio.sleep(0.1)


async def test_what_is_in_work_is_ended_when_its_process_waits_no_more() -> None:
    waits_until_s = time.monotonic() + 0.1
    with pytest.raises(TimeoutError):
        async with timeout_at(Deadline(0.01, lambda: min(time.monotonic(), waits_until_s))):
            await asyncio.sleep(10.0)


async def test_nothing_looks_at_a_deadline_once_the_work_is_done() -> None:
    looked_at_s: list[float] = []

    def run_delay_s() -> float:
        looked_at_s.append(time.monotonic())
        return 0.0

    async with timeout_at(Deadline(0.01, run_delay_s)):
        pass
    done_s = time.monotonic()
    await asyncio.sleep(0.05)
    assert max(looked_at_s) <= done_s


meshes = st.integers(0, 3 * PART_BYTES // 24).map(
    lambda vertices: Mesh(np.zeros((vertices, 3)), np.zeros((0, 3), dtype=np.int32))
)


@given(st.lists(st.one_of(meshes, st.just(Box((1.0, 1.0, 1.0)))), max_size=20))
def test_parts_hold_all_objects_in_order_and_none_could_do_with_fewer(shapes: list[Mesh | Box]) -> None:
    objects = tuple(SceneObject(str(i), ((shape, Pose()),)) for i, shape in enumerate(shapes))
    divided = list(parts(objects))
    assert tuple(each for part in divided for each in part) == objects
    for part in divided:
        sizes = [
            OBJECT_BYTES + (shape.vertices_m.nbytes if isinstance(shape, Mesh) else 0)
            for each in part
            for shape, _ in each.shapes
        ]
        assert sum(sizes[:-1]) < PART_BYTES


def test_ten_thousand_objects_come_in_many_parts() -> None:
    assert max(len(part) for part in parts(boxes(10_000))) <= 128


@pytest.mark.parametrize("allowed_s", [math.nan, math.inf, -1.0, 1e9])
def test_a_time_out_of_reason_does_not_hold_a_worker_for_ever(allowed_s: float) -> None:
    assert allowed_time_s(dataclasses.replace(EASY, allowed_time_s=allowed_s)) == MAX_ALLOWED_TIME_S


def test_every_kind_of_request_has_an_allowed_time() -> None:
    assert allowed_time_s(dataclasses.replace(EASY, allowed_time_s=0.7)) == 0.7
    assert all(0.0 < allowed_time_s(request) < 10.0 for request, _ in REQUESTS)
