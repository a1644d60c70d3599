from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable

import pytest

from protocol.errors import MessageError
from protocol.publication import EncodedMessage, Frame
from server.gateway.turns import ROUND_S, TURN_S, Threads, Turns
from tests.helpers.clock import FakeClock

TIMEOUT_S = 30.0


class Loop:
    """Event loop that turns when it is told to."""

    def __init__(self) -> None:
        self._soon: deque[Callable[[], object]] = deque()

    def call_soon(self, callback: Callable[[], object]) -> None:
        self._soon.append(callback)

    def turn(self) -> None:
        for _ in range(len(self._soon)):
            self._soon.popleft()()


class Steps:
    """Work of some steps, each of which takes a while."""

    def __init__(self, clock: FakeClock, done: list[str], name: str, steps: int, step_s: float) -> None:
        self._clock, self._done, self._name, self._left, self._step_s = clock, done, name, steps, step_s

    def work(self, until_s: float) -> bool:
        while self._left:
            self._left -= 1
            self._done.append(self._name)
            self._clock.advance(self._step_s)
            if self._clock() >= until_s:
                break
        return self._left > 0


@pytest.fixture
def loop() -> Loop:
    return Loop()


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def turns(loop: Loop, clock: FakeClock) -> Turns:
    return Turns(loop.call_soon, clock)


def test_the_loop_serves_its_sockets_after_a_round_however_much_waits(
    loop: Loop, clock: FakeClock, turns: Turns
) -> None:
    done: list[str] = []
    for name in "abcdefgh":
        turns.add(Steps(clock, done, name, 1000, TURN_S / 10))
    before_s = clock()
    loop.turn()
    assert ROUND_S <= clock() - before_s <= ROUND_S + TURN_S / 10


def test_a_worker_with_much_to_do_gets_no_more_turns_than_one_with_little(
    loop: Loop, clock: FakeClock, turns: Turns
) -> None:
    done: list[str] = []
    turns.add(Steps(clock, done, "much", 10_000, TURN_S / 10))
    turns.add(Steps(clock, done, "little", 3, TURN_S / 10))
    loop.turn()
    assert done.count("little") == 3
    assert done.count("much") <= ROUND_S / TURN_S * 10


def test_a_step_that_takes_long_ends_the_round(loop: Loop, clock: FakeClock, turns: Turns) -> None:
    done: list[str] = []
    for name in "ab":
        turns.add(Steps(clock, done, name, 1, 10 * ROUND_S))
    loop.turn()
    assert done == ["a"]
    loop.turn()
    assert done == ["a", "b"]


def test_a_worker_that_was_removed_gets_no_turn(loop: Loop, clock: FakeClock, turns: Turns) -> None:
    done: list[str] = []
    worker = Steps(clock, done, "a", 1, 0.0)
    turns.add(worker)
    turns.remove(worker)
    loop.turn()
    assert done == []


def test_what_comes_is_done_at_once_until_the_round_is_over(loop: Loop, clock: FakeClock, turns: Turns) -> None:
    until_s = turns.until_s()
    assert until_s == clock() + TURN_S
    clock.advance(1.01 * ROUND_S)
    assert turns.until_s() is None
    loop.turn()
    assert turns.until_s() == clock() + TURN_S


class TestThreads:
    """Threads of a gateway."""

    async def test_a_job_ends_in_the_event_loop_with_its_result_and_its_cost(self) -> None:
        threads, ended = Threads(), asyncio.get_running_loop().create_future()
        threads.run(
            threading.get_ident,
            lambda thread, cost_s: ended.set_result((thread, cost_s, threading.get_ident())),
            lambda: None,
        )
        thread, cost_s, ended_in = await asyncio.wait_for(ended, TIMEOUT_S)
        threads.close()
        assert thread != ended_in == threading.get_ident()
        assert cost_s >= 0

    async def test_a_job_that_raises_is_logged_and_tells_that_it_failed(self, caplog: pytest.LogCaptureFixture) -> None:
        threads, failed = Threads(), asyncio.Event()

        def job() -> None:
            raise RuntimeError("broken")

        threads.run(job, lambda _result, _cost_s: None, failed.set)
        await asyncio.wait_for(failed.wait(), TIMEOUT_S)
        threads.close()
        assert "broken" in caplog.text

    async def test_a_message_is_encoded_once_for_all_who_ask(self) -> None:
        threads, encoded, ready = Threads(), [], asyncio.Semaphore(0)

        def encode() -> EncodedMessage:
            encoded.append(1)
            return EncodedMessage(Frame(b"{}", text=True))

        message = EncodedMessage.later(encode, 100)
        for _ in range(3):
            threads.encode(message, ready.release)
        async with asyncio.timeout(TIMEOUT_S):
            for _ in range(3):
                await ready.acquire()
        threads.close()
        assert encoded == [1]
        assert message.ready

    async def test_a_message_that_cannot_be_encoded_is_left_out_with_a_log_line(
        self, caplog: pytest.LogCaptureFixture
    ) -> None:
        threads, ready = Threads(), asyncio.Event()

        def encode() -> EncodedMessage:
            raise MessageError("a number", "nothing")

        message = EncodedMessage.later(encode, 100)
        threads.encode(message, ready.set)
        await asyncio.wait_for(ready.wait(), TIMEOUT_S)
        threads.close()
        assert message.ready
        assert message.frames == ()
        assert "not delivered" in caplog.text
