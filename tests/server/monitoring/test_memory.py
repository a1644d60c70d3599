import asyncio
import gc
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from server.monitoring import memory
from server.monitoring.memory import EXCESS_BYTES, FULL_COLLECTION_PERIOD_S, CollectorPolicy, MemoryKeeper

BASE_BYTES = 80 << 20


class StepClock:
    """A clock that goes on by a step at each look."""

    def __init__(self, step_s: float) -> None:
        self.step_s = step_s
        self.now_s = 0.0

    def __call__(self) -> float:
        self.now_s += self.step_s
        return self.now_s


class Node:
    """Something that can refer to itself."""

    alive = 0

    def __init__(self) -> None:
        self.itself = self
        Node.alive += 1

    def __del__(self) -> None:
        Node.alive -= 1


@pytest.fixture
def clock() -> StepClock:
    return StepClock(0.0)


@pytest.fixture
def collector(clock: StepClock) -> Iterator[CollectorPolicy]:
    # What the collected tests hold stays out of it: a collection of all would take seconds.
    made = CollectorPolicy(clock, keeps_frozen=True)
    made.start()
    yield made
    made.stop()


@pytest.mark.parametrize(("step_s", "generation", "left_out"), [(0.1, 2, True), (0.0, 2, False), (0.1, 1, False)])
def test_what_outlives_a_slow_collection_of_all_is_not_gone_through_again(
    collector: CollectorPolicy, clock: StepClock, step_s: float, generation: int, left_out: bool
) -> None:
    clock.step_s = step_s
    lists = [[] for _ in range(1000)]
    gc.collect(generation)
    assert collector.overdue is left_out
    assert any(each is lists[0] for each in gc.get_objects()) is not left_out


def test_garbage_that_was_left_out_is_found_by_a_collection_of_all(clock: StepClock) -> None:
    collector = CollectorPolicy(clock)
    collector.start()
    clock.step_s = 0.1
    node = Node()
    gc.collect()
    del node
    gc.collect()
    assert Node.alive == 1
    collector.collect_all()
    collector.stop()
    assert (Node.alive, collector.overdue) == (0, False)


def test_the_collector_is_put_back_to_what_it_was() -> None:
    before = gc.get_threshold(), list(gc.callbacks)
    collector = CollectorPolicy(keeps_frozen=True)
    collector.start()
    assert gc.get_threshold() == memory.THRESHOLDS
    collector.stop()
    collector.stop()
    assert (gc.get_threshold(), gc.callbacks) == before


class Collections(CollectorPolicy):
    """A policy whose collections of all are only counted."""

    def __init__(self) -> None:
        super().__init__()
        self.made, self.overdue = 0, True

    def collect_all(self) -> None:
        self.made += 1


class KeeperRig:
    """A keeper of memory that a test sets."""

    def __init__(self) -> None:
        self.collector = Collections()
        self.quiet = True
        self.resident = BASE_BYTES
        self.gain = 0
        self.trims: list[float] = []
        self.threads: set[str] = set()
        self.now_s = 0.0
        self.keeper = MemoryKeeper(self.collector, lambda: self.quiet, lambda: self.resident, self._trim)

    def _trim(self) -> None:
        self.threads.add(threading.current_thread().name)
        self.trims.append(self.now_s)
        self.resident -= self.gain

    async def check(self, seconds: int = 1) -> None:
        for _ in range(seconds):
            self.now_s += 1.0
            await self.keeper.check(self.now_s)


@pytest.fixture
async def rig() -> KeeperRig:
    made = KeeperRig()
    await made.check(2)
    return made


async def test_memory_of_a_burst_is_given_back_by_a_thread_and_trims_keep_their_distance(rig: KeeperRig) -> None:
    rig.resident, rig.gain = BASE_BYTES + EXCESS_BYTES, EXCESS_BYTES
    await rig.check(3)
    assert len(rig.trims) == 1
    assert threading.current_thread().name not in rig.threads
    rig.resident, rig.gain = BASE_BYTES + 10 * EXCESS_BYTES, 0
    await rig.check(int(3.5 * memory.TRIM_PERIOD_S))
    assert np.diff(rig.trims).tolist() == [memory.TRIM_PERIOD_S] * 3


async def test_a_little_memory_and_memory_that_grows_are_kept(rig: KeeperRig) -> None:
    rig.resident += EXCESS_BYTES - 1
    await rig.check(10)
    for _ in range(10):
        rig.resident += EXCESS_BYTES
        await rig.check()
    assert not rig.trims


async def test_while_something_moves_nothing_pauses_for_memory(rig: KeeperRig) -> None:
    rig.resident += 10 * EXCESS_BYTES
    rig.quiet = False
    await rig.check(int(2 * FULL_COLLECTION_PERIOD_S))
    assert (len(rig.trims), rig.collector.made) == (0, 1)
    rig.quiet = True
    await rig.check()
    assert (len(rig.trims), rig.collector.made) == (1, 2)


async def test_all_is_collected_no_more_often_than_its_period(rig: KeeperRig) -> None:
    await rig.check(int(3 * FULL_COLLECTION_PERIOD_S) - 10)
    assert rig.collector.made == 3


@pytest.mark.stepped_time
async def test_all_is_not_collected_again_right_after_the_start(rig: KeeperRig) -> None:
    rig.collector.made = 0
    running = asyncio.create_task(rig.keeper.run())
    await asyncio.sleep(10.0)
    running.cancel()
    assert rig.collector.made == 0


def test_free_memory_between_used_memory_is_given_back() -> None:
    # Of a size that is taken from the heap, and not by itself from the system.
    taken = [bytearray(3000) for _ in range(20_000)]
    kept = taken[::50]
    full = memory.resident_bytes()
    del taken
    memory.trim_heap()
    assert full - memory.resident_bytes() > 40_000_000
    assert kept


def test_a_forked_server_leaves_what_was_frozen_before_the_fork_alone() -> None:
    gc.collect()
    Node()
    gc.freeze()
    try:
        collector = CollectorPolicy(keeps_frozen=True)
        collector.start()
        alive = Node.alive
        collector.stop()
    finally:
        gc.unfreeze()
        gc.collect()
    assert (alive, Node.alive) == (1, 0)
