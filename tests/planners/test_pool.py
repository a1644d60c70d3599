from __future__ import annotations

import asyncio
import dataclasses
import errno
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import pytest_asyncio
from hypothesis import given
from hypothesis import strategies as st

from planners import budget
from planners import pool as pool_module
from planners.budget import Deadline
from planners.pipeline import Planner
from planners.pool import (
    MAX_ALLOWED_TIME_S,
    MAX_WAITING,
    OBJECT_BYTES,
    PART_BYTES,
    OnHard,
    PlannerPool,
    WorkerProcess,
    allowed_time_s,
    parts,
    timeout_at,
)
from planners.problem import (
    Answer,
    MoveItErrorCode,
    Plan,
    PlanningFailure,
    RecheckQuestion,
    Request,
    StateAnswer,
)
from planners.scene import Box, Mesh, Pose, Scene, SceneObject
from planners.servo.question import JointVelocities, ServoQuestion
from robot.channel import MAX_MESSAGE_BYTES
from robot.description import model
from tests.helpers import broken_planner
from tests.helpers.motions import EASY, LONG, REQUESTS, START, STATE, STILL, broken
from tests.helpers.resources import no_descriptors_left
from tests.helpers.robots import so101
from tests.helpers.waiting import until

TWINS = (SceneObject("twin", ((Box((0.1, 0.1, 0.1)), Pose((2.0, 0.0, 0.0))),)),) * 2


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def worker() -> AsyncIterator[WorkerProcess]:
    loaded = asyncio.Event()
    made = WorkerProcess(so101(), 1 << 30, lambda _worker, _refusal: loaded.set(), lambda _worker: None)
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
async def test_a_request_too_large_for_a_message_is_refused_and_harms_nothing(worker: WorkerProcess) -> None:
    huge = Mesh(np.zeros((MAX_MESSAGE_BYTES // 24 + 1, 3)), np.zeros((0, 3), dtype=np.int32))
    answer = await worker.ask(STATE, Scene(4, (SceneObject("huge", ((huge, Pose()),)),)))
    assert isinstance(answer, PlanningFailure)
    assert str(MAX_MESSAGE_BYTES) in answer.message
    assert isinstance(await worker.ask(STATE, Scene(5)), StateAnswer)


@in_one_loop
async def test_a_cancelled_worker_that_waits_for_a_core_is_waited_for(
    worker: WorkerProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool_module, "CANCEL_TIMEOUT_S", 0.02)
    monkeypatch.setattr(pool_module, "read_run_delay_s", lambda _pid: time.monotonic())
    asking = asyncio.create_task(worker.ask(LONG, Scene(6)))
    await until(lambda: worker._answer is not None and not worker._answer.done())
    os.kill(worker.pid, signal.SIGSTOP)
    cancelling = asyncio.create_task(worker.cancel())
    await asyncio.sleep(0.2)
    os.kill(worker.pid, signal.SIGCONT)
    await asyncio.gather(cancelling, asking)
    assert worker.usable


async def test_work_is_cancelled_once_its_deadline_has_passed() -> None:
    with pytest.raises(TimeoutError):
        async with timeout_at(Deadline(0.01, lambda: 0.0)):
            await asyncio.sleep(10.0)


async def test_work_is_not_cancelled_while_its_process_waits_for_a_core() -> None:
    async with timeout_at(Deadline(0.01, time.monotonic)):
        await asyncio.sleep(0.1)


async def test_work_is_cancelled_when_its_process_waits_no_more() -> None:
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
async def test_parts_hold_all_objects_in_order_and_none_could_do_with_fewer(shapes: list[Mesh | Box]) -> None:
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


async def test_ten_thousand_objects_come_in_many_parts() -> None:
    assert max(len(part) for part in parts(boxes(10_000))) <= 128


@pytest.mark.parametrize("allowed_s", [math.nan, math.inf, -1.0, 1e9])
async def test_a_time_out_of_reason_does_not_hold_a_worker_for_ever(allowed_s: float) -> None:
    assert allowed_time_s(dataclasses.replace(EASY, allowed_time_s=allowed_s)) == MAX_ALLOWED_TIME_S


async def test_every_kind_of_request_has_an_allowed_time() -> None:
    assert allowed_time_s(dataclasses.replace(EASY, allowed_time_s=0.7)) == 0.7
    assert all(0.0 < allowed_time_s(request) < 10.0 for request, _ in REQUESTS)


# Workers load for half a second: one pool serves the tests of this file, and so shows that it survives each.
pytestmark = pytest.mark.asyncio(loop_scope="module")

ROOT = Path(__file__).parents[2]
MEMORY_LIMIT_BYTES = 300 << 20


def made_of(robot: model.RobotModel) -> PlannerPool:
    return PlannerPool(robot, memory_limit_bytes=MEMORY_LIMIT_BYTES)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def pool() -> AsyncIterator[PlannerPool]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT))
        patch.setattr(pool_module, "WORKER_MODULE", "tests.helpers.broken_planner")
        made = made_of(so101())
        await made.start()
        assert made.idle_count == 0
        yield made
        await made.close()


@pytest_asyncio.fixture(loop_scope="module")
async def both_idle(pool: PlannerPool) -> PlannerPool:
    """The pool once it has recovered from whatever came before."""
    async with asyncio.timeout(60.0):
        while pool.idle_count < 2:
            await asyncio.sleep(0.01)
    return pool


def kill_all(pool: PlannerPool) -> None:
    """End the workers; the pool cannot have heard of it yet, as this does not give the event loop a turn."""
    for pid in pool.pids:
        os.kill(pid, signal.SIGKILL)
    while any(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE for pid in pool.pids):
        time.sleep(0.01)


async def given_up(pool: PlannerPool, request: Request, after_s: float) -> None:
    """Ask, and cancel while a worker works on it."""
    asking = asyncio.create_task(pool.ask(request))
    await asyncio.sleep(after_s)
    assert not asking.done()
    asking.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asking


async def test_requests_sent_together_while_workers_load_are_all_answered(pool: PlannerPool) -> None:
    answers = await asyncio.gather(*(pool.ask(EASY) for _ in range(5)))
    assert all(isinstance(answer, Plan) for answer in answers)
    assert pool.idle_count > 0


async def test_one_worker_stands_by_beside_the_active_ones(both_idle: PlannerPool) -> None:
    assert len(both_idle.pids) == both_idle.loaded_count == 2


@pytest.mark.parametrize(("request_", "kind"), REQUESTS, ids=[type(request).__name__ for request, _ in REQUESTS])
async def test_every_kind_of_request_gets_its_kind_of_answer(
    both_idle: PlannerPool, request_: Request, kind: type[Answer]
) -> None:
    assert isinstance(await both_idle.ask(request_), kind)


FAULTS = {
    broken_planner.SEGFAULT: "the planner process ended (SIGSEGV)",
    broken_planner.ABORT: "the planner process ended (SIGABRT)",
    broken_planner.EXIT: "the planner process ended (exit code 3)",
    broken_planner.MEMORY: "more than the 315 MB of memory",
    broken_planner.EXCEPTION: "ValueError: a bug",
    broken_planner.WRONG_ANSWER: "answered a PlanningProblem with StateAnswer",
    broken_planner.NO_ANSWER: "answered a PlanningProblem with str",
    broken_planner.NOT_TO_BE_PACKED: "the planner process ended (exit code 1)",
    broken_planner.NO_MESSAGE: "the planner process ended (SIGKILL)",
    broken_planner.HUGE_MESSAGE: "the planner process ended (SIGKILL)",
}


@pytest.mark.parametrize("fault", FAULTS)
async def test_a_fault_of_a_worker_costs_one_goal(pool: PlannerPool, fault: str) -> None:
    answer = await pool.ask(broken(fault))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.CRASH
    assert FAULTS[fault] in answer.message
    assert isinstance(await pool.ask(EASY), Plan)


async def test_a_worker_that_ran_out_of_memory_is_replaced(both_idle: PlannerPool) -> None:
    before = set(both_idle.pids)
    await both_idle.ask(broken(broken_planner.MEMORY))
    async with asyncio.timeout(60.0):
        while both_idle.idle_count < 2:
            await asyncio.sleep(0.01)
    assert len(before & set(both_idle.pids)) == 1


async def test_a_worker_that_hangs_answers_timed_out_and_is_replaced(both_idle: PlannerPool) -> None:
    before = both_idle.pids
    answer = await both_idle.ask(broken(broken_planner.NATIVE_LOOP, allowed_time_s=0.1))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.TIMED_OUT
    assert "0.1 s" in answer.message
    assert isinstance(await both_idle.ask(EASY), Plan)
    async with asyncio.timeout(60.0):
        while both_idle.idle_count < 2:
            await asyncio.sleep(0.01)
    assert len(set(before) & set(both_idle.pids)) == 1


async def test_questions_do_not_wait_for_a_motion_in_planning(both_idle: PlannerPool) -> None:
    planning = asyncio.create_task(both_idle.ask(LONG))
    await asyncio.sleep(0.1)
    assert isinstance(await both_idle.ask(STATE), StateAnswer)
    assert not planning.done()
    planning.cancel()
    await asyncio.wait([planning])


async def in_background(pool: PlannerPool) -> asyncio.Task[Plan | PlanningFailure | None]:
    """Have a long search be made in the background."""
    planning = asyncio.create_task(pool.ask_in_background(LONG))
    await until(lambda: pool.idle_count < 2)
    return planning


async def test_a_motion_is_planned_in_the_background(both_idle: PlannerPool) -> None:
    assert isinstance(await both_idle.ask_in_background(EASY), Plan)


async def test_a_motion_in_the_background_gives_way_to_one_that_is_due(both_idle: PlannerPool) -> None:
    before = both_idle.pids
    planning = await in_background(both_idle)
    assert isinstance(await both_idle.ask(EASY), Plan)
    assert await planning is None
    assert both_idle.pids == before


async def test_a_motion_in_the_background_goes_on_while_questions_are_answered(both_idle: PlannerPool) -> None:
    planning = await in_background(both_idle)
    assert isinstance(await both_idle.ask(STATE), StateAnswer)
    assert not planning.done()
    planning.cancel()
    await asyncio.wait([planning])


async def test_nothing_is_planned_in_the_background_while_a_motion_is_due(both_idle: PlannerPool) -> None:
    due = asyncio.create_task(both_idle.ask(LONG))
    await until(lambda: both_idle.idle_count < 2)
    assert await both_idle.ask_in_background(EASY) is None
    assert not due.done()
    due.cancel()
    await asyncio.wait([due])


async def test_a_motion_in_the_background_does_not_give_way_to_another_there(both_idle: PlannerPool) -> None:
    planning = await in_background(both_idle)
    assert await both_idle.ask_in_background(EASY) is None
    assert not planning.done()
    planning.cancel()
    await asyncio.wait([planning])


async def test_a_motion_in_the_background_that_is_given_up_frees_its_worker(both_idle: PlannerPool) -> None:
    before = both_idle.pids
    planning = await in_background(both_idle)
    planning.cancel()
    await until(lambda: both_idle.idle_count == 2)
    assert planning.cancelled()
    assert both_idle.pids == before


async def test_a_worker_that_dies_over_a_motion_in_the_background_is_told_and_replaced(both_idle: PlannerPool) -> None:
    answer = await both_idle.ask_in_background(broken(broken_planner.SEGFAULT))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.CRASH
    await until(lambda: both_idle.idle_count == 2)


async def test_cancelling_ends_a_long_search_and_keeps_its_worker(both_idle: PlannerPool) -> None:
    before = both_idle.pids
    for _ in range(3):
        await given_up(both_idle, LONG, 0.1)
        assert isinstance(await both_idle.ask(EASY), Plan)
    assert both_idle.pids == before


async def test_the_spare_takes_over_before_a_cancelled_worker_listens(
    both_idle: PlannerPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool_module, "CANCEL_TIMEOUT_S", 60.0)
    before = set(both_idle.pids)
    await given_up(both_idle, broken(broken_planner.DEAF), 0.05)
    assert isinstance(await asyncio.wait_for(both_idle.ask(EASY), 30.0), Plan)
    assert set(both_idle.pids) == before
    for pid in before:
        os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize("fault", [broken_planner.NATIVE_LOOP, broken_planner.DEAF])
async def test_a_cancelled_worker_that_does_not_listen_is_replaced(both_idle: PlannerPool, fault: str) -> None:
    before = set(both_idle.pids)
    await given_up(both_idle, broken(fault), 0.05)
    async with asyncio.timeout(60.0):
        while both_idle.idle_count < 2:
            await asyncio.sleep(0.01)
    assert len(before & set(both_idle.pids)) == 1


async def test_workers_that_died_while_idle_cost_no_goal(both_idle: PlannerPool) -> None:
    kill_all(both_idle)
    assert isinstance(await both_idle.ask(EASY), Plan)


async def test_more_requests_than_may_wait_are_refused(both_idle: PlannerPool) -> None:
    asking = [asyncio.create_task(both_idle.ask(LONG)) for _ in range(MAX_WAITING + 1)]
    await until(lambda: both_idle.waiting_count == MAX_WAITING)
    answer = await both_idle.ask(EASY)
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.FAILURE
    assert f"limit {MAX_WAITING}" in answer.message
    for task in asking:
        task.cancel()
    await asyncio.wait(asking)


async def test_a_robot_that_no_worker_can_load_is_told() -> None:
    broken_robot = made_of(dataclasses.replace(so101(), urdf="<robot/>"))
    await broken_robot.start()
    answer = await broken_robot.ask(EASY)
    await broken_robot.close()
    assert broken_robot.pids == ()
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.FAILURE
    assert "planning is not available" in answer.message


async def test_the_wait_for_a_worker_ends_with_the_reason_where_the_robot_is_refused() -> None:
    broken_robot = made_of(dataclasses.replace(so101(), urdf="<robot/>"))
    await broken_robot.start()
    reason = await asyncio.wait_for(broken_robot.wait_until_loaded(), 60.0)
    await broken_robot.close()
    assert reason == broken_robot.load_failure
    assert reason


async def test_the_wait_for_a_worker_ends_when_one_takes_requests() -> None:
    pool = made_of(so101())
    await pool.start()
    assert pool.loaded_count == 0
    assert await asyncio.wait_for(pool.wait_until_loaded(), 60.0) is None
    assert pool.loaded_count == 1
    await pool.close()


async def test_the_wait_for_a_worker_ends_where_the_pool_is_closed() -> None:
    pool = made_of(so101())
    await pool.start()
    waiting = asyncio.create_task(pool.wait_until_loaded())
    await asyncio.sleep(0)
    await pool.close()
    assert await asyncio.wait_for(waiting, 30.0) is None


async def test_after_failed_starts_requests_wait_for_the_next_worker_that_loads(
    both_idle: PlannerPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool_module, "RESTART_PAUSE_S", 0.1)
    monkeypatch.setattr(pool_module, "WORKER_MODULE", "planners.no_such_module")
    kill_all(both_idle)
    asking = asyncio.create_task(both_idle.ask(EASY))
    async with asyncio.timeout(60.0):
        while both_idle._failed_starts < pool_module.MAX_FAILED_STARTS:
            await asyncio.sleep(0.01)
    monkeypatch.setattr(pool_module, "WORKER_MODULE", "tests.helpers.broken_planner")
    assert isinstance(await asking, Plan)


async def test_workers_that_never_start_are_told_and_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool_module, "RESTART_PAUSE_S", 0.01)
    monkeypatch.setattr(pool_module, "WORKER_MODULE", "planners.no_such_module")
    pool = made_of(so101())
    await pool.start()
    answer = await asyncio.wait_for(pool.ask(EASY), 60.0)
    assert isinstance(answer, PlanningFailure)
    assert "planner processes ended while starting" in answer.message
    monkeypatch.setattr(pool_module, "WORKER_MODULE", "planners.worker")
    async with asyncio.timeout(60.0):
        while pool.load_failure is not None:
            await asyncio.sleep(0.01)
    assert isinstance(await pool.ask(EASY), Plan)
    await pool.close()


async def test_workers_come_back_where_clients_have_used_up_all_descriptors(both_idle: PlannerPool) -> None:
    kill_all(both_idle)
    with no_descriptors_left():
        async with asyncio.timeout(60.0):
            while sum(worker.usable for worker in both_idle._idle) < 2:
                await asyncio.sleep(0.01)
    assert isinstance(await both_idle.ask(EASY), Plan)


async def test_a_worker_that_cannot_be_read_is_ended_and_replaced(
    both_idle: PlannerPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = asyncio.get_running_loop()
    connect, failed = loop.create_unix_connection, []

    async def fail_once(*arguments: Any, **options: Any) -> Any:
        if not failed:
            failed.append(arguments)
            raise OSError(errno.ENOSPC, "No space left on device")
        return await connect(*arguments, **options)

    monkeypatch.setattr(loop, "create_unix_connection", fail_once)
    kill_all(both_idle)
    async with asyncio.timeout(60.0):
        while sum(worker.usable for worker in both_idle._idle) < 2:
            await asyncio.sleep(0.01)
    assert failed
    assert len(both_idle.pids) == 2
    assert isinstance(await both_idle.ask(EASY), Plan)


async def test_a_worker_that_hangs_while_it_loads_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool_module, "LOAD_TIMEOUT_S", 0.1)
    monkeypatch.setattr(pool_module, "MAX_FAILED_STARTS", 1)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    # It lives, but never says that it has loaded anything.
    monkeypatch.setattr(pool_module, "WORKER_MODULE", "tests.helpers.echo_child")
    pool = made_of(so101())
    await pool.start()
    async with asyncio.timeout(60.0):
        while pool.load_failure is None:
            await asyncio.sleep(0.01)
    await pool.close()
    assert pool.pids == ()


async def test_a_worker_that_has_the_scene_is_taken_before_one_that_has_not(both_idle: PlannerPool) -> None:
    first, second = both_idle._idle
    await both_idle.ask(EASY, Scene(1))
    assert first.has(Scene(1))
    assert [worker.pid for worker in both_idle._idle] == [second.pid, first.pid]
    await both_idle.ask(EASY, Scene(1))
    assert not second.has(Scene(1))


class StarvedWorker:
    """A worker that does nothing but wait for a core; it gives its answer later than it may, or none."""

    usable = True

    def __init__(self, answer: Answer | None) -> None:
        self.cancelled = 0
        self.killed = 0
        self._answer = answer

    def run_delay_s(self) -> float | None:
        return time.monotonic()

    def has(self, scene: Scene) -> bool:
        return True

    async def ask(self, request: Request, scene: Scene, on_hard: OnHard) -> Answer:
        await asyncio.sleep(0.2 if self._answer is not None else 60.0)
        assert self._answer is not None
        return self._answer

    async def cancel(self) -> None:
        self.cancelled += 1

    async def kill(self) -> None:
        self.killed += 1


def with_worker(worker: StarvedWorker) -> PlannerPool:
    """A pool that has this worker and no process."""
    pool = made_of(so101())
    pool._put_back(worker)
    return pool


LATE = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "late")


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Deadlines of questions, and of motions in EASY_AT_ONCE, that pass before a starved worker answers."""
    monkeypatch.setattr(pool_module, "CHECK_TIME_S", 0.05)
    monkeypatch.setattr(pool_module, "OVERTIME_S", 0.05)


EASY_AT_ONCE = dataclasses.replace(EASY, allowed_time_s=0.05)
RECHECK = RecheckQuestion("arm", STILL, START, 0.0)
SERVO = ServoQuestion("arm", "gripper_frame_link", START, {}, 0.02, JointVelocities({}))


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize("request_", [EASY_AT_ONCE, STATE], ids=["a motion", "a question"])
async def test_a_worker_that_waits_for_a_core_is_waited_for(request_: Request) -> None:
    assert await with_worker(StarvedWorker(LATE)).ask(request_) is LATE


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize("request_", [RECHECK, SERVO], ids=["a recheck", "steering"])
async def test_while_an_arm_moves_a_worker_starved_of_cores_is_not_waited_for(request_: Request) -> None:
    starved = StarvedWorker(None)
    pool = with_worker(starved)
    answer = await asyncio.wait_for(pool.ask(request_), 30.0)
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.TIMED_OUT
    await pool.close()
    assert (starved.cancelled, starved.killed) == (1, 0)


@pytest.mark.usefixtures("brief")
async def test_a_worker_that_waits_for_a_core_for_ever_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budget, "MAX_STARVED_S", 0.2)
    starved = StarvedWorker(None)
    pool = with_worker(starved)
    answer = await asyncio.wait_for(pool.ask(EASY_AT_ONCE), 30.0)
    assert isinstance(answer, PlanningFailure)
    assert answer.message == "the planner did not answer within 0.05 s and was given up"
    await pool.close()
    assert starved.killed == 1


@pytest.fixture
def busy_core() -> Iterator[int]:
    """A core that eight processes want all the time."""
    core = max(os.sched_getaffinity(0))
    program = f"import os; os.sched_setaffinity(0, {{{core}}})\nwhile True: pass"
    # Each in a session of its own: a kernel that shares cores out by session would give all eight one worker's share.
    burners = [subprocess.Popen([sys.executable, "-c", program], start_new_session=True) for _ in range(8)]
    yield core
    for burner in burners:
        burner.kill()
        burner.wait()


@pytest_asyncio.fixture(loop_scope="module")
async def on_a_busy_core(both_idle: PlannerPool, busy_core: int) -> AsyncIterator[PlannerPool]:
    """The pool with its workers on that core."""
    workers = both_idle.pids
    for pid in workers:
        os.sched_setaffinity(pid, {busy_core})
    yield both_idle
    for pid in set(workers) & set(both_idle.pids):
        os.sched_setaffinity(pid, os.sched_getaffinity(0))


needs_run_delay = pytest.mark.skipif(
    budget.read_run_delay_s(os.getpid()) is None, reason="this kernel does not count waits for a core"
)

# A quarter of a second of work.
WORK = dataclasses.replace(LONG, allowed_time_s=0.8, optimization_time_s=0.02, attempts=10)


@needs_run_delay
async def test_a_busy_machine_does_not_change_what_is_planned(
    on_a_busy_core: PlannerPool, planner: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool_module, "OVERTIME_S", 0.1)
    # The racer that comes in first depends on the machine.
    monkeypatch.setattr(on_a_busy_core, "_racing", False)
    before = on_a_busy_core.pids
    plan = await on_a_busy_core.ask(WORK)
    elsewhere = planner.plan(dataclasses.replace(WORK, allowed_time_s=60.0))
    assert isinstance(plan, Plan)
    assert isinstance(elsewhere, Plan)
    assert np.array_equal(plan.trajectory.positions_rad, elsewhere.trajectory.positions_rad)
    assert on_a_busy_core.pids == before


@needs_run_delay
async def test_a_worker_that_hangs_is_given_up_as_soon_on_a_busy_machine(on_a_busy_core: PlannerPool) -> None:
    began_s = time.monotonic()
    answer = await on_a_busy_core.ask(broken(broken_planner.DEAF, allowed_time_s=0.1))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.TIMED_OUT
    # Nobody waits for a core that it does not want.
    assert time.monotonic() - began_s < budget.MAX_STARVED_S
