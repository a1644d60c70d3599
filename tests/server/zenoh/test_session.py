from __future__ import annotations

import asyncio
import contextlib
import logging
import queue
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
import zenoh

from server.zenoh import session as session_module
from server.zenoh.session import ReceiveQueue, SessionThread
from server.zenoh.settings import ZenohSettings, session_config
from tests.helpers.waiting import until

# The threads; sessions are real ones, none of which connects anywhere.


def open_session() -> zenoh.Session:
    return zenoh.open(session_config(ZenohSettings(mode="peer")))


TIMEOUT_S = 30.0


@contextlib.contextmanager
def hanging(do: Callable[[session_module.Job], bool]) -> Iterator[None]:
    """Job that hangs for as long as the block lasts; fails where the block waited for it."""
    go_on, timed_out = threading.Event(), threading.Event()

    def hang(_session: zenoh.Session) -> None:
        if not go_on.wait(2 * TIMEOUT_S):
            timed_out.set()

    do(hang)
    yield
    assert not timed_out.is_set()
    go_on.set()


class Opened:
    """Waits for the session."""

    def __init__(self) -> None:
        self.thread = SessionThread(open_session)

    def wait(self) -> str:
        return self.thread.opened.result(TIMEOUT_S)


@pytest.fixture
def opened() -> Iterator[Opened]:
    running = Opened()
    running.thread.start()
    running.wait()
    yield running
    running.thread.close()


def test_jobs_are_done_in_their_order_with_the_open_session(opened: Opened) -> None:
    done: queue.Queue[tuple[int, bool]] = queue.Queue()
    for number in range(3):
        assert opened.thread.submit(lambda session, number=number: done.put((number, session.is_closed())))
    assert [done.get(timeout=TIMEOUT_S) for _ in range(3)] == [(0, False), (1, False), (2, False)]


def test_a_job_that_fails_ends_no_other(opened: Opened, caplog: pytest.LogCaptureFixture) -> None:
    done = threading.Event()

    def fail(_session: zenoh.Session) -> None:
        raise RuntimeError("a bug")

    opened.thread.submit(lambda session: session.put("not//a/key", b""))
    opened.thread.submit(fail)
    opened.thread.submit(lambda _session: done.set())
    assert done.wait(TIMEOUT_S)
    assert [record.levelno for record in caplog.records] == [logging.WARNING, logging.ERROR]


def test_work_submitted_before_the_end_is_done(opened: Opened) -> None:
    go_on, done = threading.Event(), threading.Event()
    opened.thread.submit(lambda _session: go_on.wait(TIMEOUT_S))
    opened.thread.submit(lambda _session: done.set())
    with ThreadPoolExecutor(1) as other:
        closed = other.submit(opened.thread.close)
        go_on.set()
        assert closed.result(TIMEOUT_S)
    assert done.is_set()


def test_a_call_that_waits_for_its_machine_holds_up_no_topic(opened: Opened) -> None:
    done = threading.Event()
    with hanging(opened.thread.submit_call):
        opened.thread.submit(lambda _session: done.set())
        assert done.wait(TIMEOUT_S)


def test_a_call_that_waits_for_its_machine_does_not_hold_up_the_end(opened: Opened) -> None:
    with hanging(opened.thread.submit_call):
        assert opened.thread.close()


def test_a_network_that_stands_still_holds_up_neither_work_nor_the_end(
    opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session_module, "CLOSE_TIMEOUT_S", 0.05)
    with hanging(opened.thread.submit):
        accepted = sum(opened.thread.submit(lambda _session: None) for _ in range(session_module.MAX_JOBS + 10))
        assert not opened.thread.close()
    assert session_module.MAX_JOBS - 1 <= accepted <= session_module.MAX_JOBS
    assert opened.thread.rejected >= 9


def test_a_session_that_cannot_be_opened_is_tried_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(session_module, "RETRY_PERIOD_S", 0.01)
    tries = iter([zenoh.ZError("no router at /a/line/of/zenoh"), zenoh.ZError("no router at /a/line/of/zenoh"), None])

    def open_later() -> zenoh.Session:
        error = next(tries)
        if error is not None:
            raise error
        return open_session()

    thread = SessionThread(open_later)
    thread.start()
    assert thread.opened.result(TIMEOUT_S)
    assert [record.message for record in caplog.records] == [
        "zenoh: not open yet: no router; trying again every 0.01 s"
    ]
    assert thread.close()


def test_a_session_that_never_opens_does_not_hold_up_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_module, "RETRY_PERIOD_S", 10 * session_module.CLOSE_TIMEOUT_S)

    def open_never() -> zenoh.Session:
        raise zenoh.ZError("no router")

    thread = SessionThread(open_never)
    thread.start()
    assert thread.close()


# The queue to the event loop.


async def test_items_of_other_threads_come_to_the_loop_in_order() -> None:
    taken: list[int] = []
    box = ReceiveQueue[int](asyncio.get_running_loop(), taken.append)
    thread = threading.Thread(target=lambda: [box.put(number, 1) for number in range(100)])
    thread.start()
    await until(lambda: len(taken) == 100)
    thread.join()
    assert taken == list(range(100))
    assert box.dropped == 0


async def test_of_too_many_items_the_newest_are_kept() -> None:
    taken: list[int] = []
    box = ReceiveQueue[int](asyncio.get_running_loop(), taken.append)
    for number in range(session_module.MAX_WAITING + 5):
        box.put(number, 1)
    await until(lambda: len(taken) >= session_module.MAX_WAITING)
    assert taken == list(range(5, session_module.MAX_WAITING + 5))
    assert box.dropped == 5


async def test_of_too_large_items_the_newest_are_kept() -> None:
    taken: list[int] = []
    box = ReceiveQueue[int](asyncio.get_running_loop(), taken.append)
    for number in range(3):
        box.put(number, session_module.MAX_WAITING_BYTES // 2)
    await until(lambda: len(taken) >= 2)
    assert taken == [1, 2]


async def test_a_full_inbox_lets_others_have_their_turn() -> None:
    taken: list[int] = []
    box = ReceiveQueue[int](asyncio.get_running_loop(), taken.append)
    for number in range(3 * session_module.ITEMS_AT_A_TIME):
        box.put(number, 1)
    await asyncio.sleep(0)
    assert len(taken) <= session_module.ITEMS_AT_A_TIME


def test_items_after_the_end_of_the_loop_are_dropped_silently() -> None:
    loop = asyncio.new_event_loop()
    box = ReceiveQueue[int](loop, lambda _item: None)
    loop.close()
    box.put(1, 1)
