import asyncio
import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
import zenoh

from harness.waiting import TIMEOUT_S, until
from server.zenoh import session as session_module
from server.zenoh.session import ReceiveQueue, SessionThread
from server.zenoh.settings import ZenohSettings, session_config

# The threads; sessions are real ones, none of which connects anywhere.


def open_session() -> zenoh.Session:
    return zenoh.open(session_config(ZenohSettings(mode="peer")))


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


@pytest.fixture
def opened() -> Iterator[SessionThread]:
    """A thread with an open session."""
    thread = SessionThread(open_session)
    thread.start()
    assert thread.opened.result(TIMEOUT_S)
    yield thread
    thread.close()


def test_a_job_that_fails_ends_no_other(opened: SessionThread, caplog: pytest.LogCaptureFixture) -> None:
    done = threading.Event()

    def fail(_session: zenoh.Session) -> None:
        raise RuntimeError("a bug")

    opened.submit(lambda session: session.put("not//a/key", b""))
    opened.submit(fail)
    opened.submit(lambda _session: done.set())
    assert done.wait(TIMEOUT_S)
    assert [record.levelno for record in caplog.records] == [logging.WARNING, logging.ERROR]


def test_work_submitted_before_the_end_is_done(opened: SessionThread) -> None:
    go_on, done = threading.Event(), threading.Event()
    opened.submit(lambda _session: go_on.wait(TIMEOUT_S))
    opened.submit(lambda _session: done.set())
    with ThreadPoolExecutor(1) as other:
        closed = other.submit(opened.close)
        go_on.set()
        assert closed.result(TIMEOUT_S)
    assert done.is_set()


def test_a_call_that_waits_for_its_machine_holds_up_neither_topics_nor_the_end(opened: SessionThread) -> None:
    done = threading.Event()
    with hanging(opened.submit_call):
        opened.submit(lambda _session: done.set())
        assert done.wait(TIMEOUT_S)
        assert opened.close()


def test_a_stuck_network_delays_neither_work_nor_end(opened: SessionThread, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_module, "CLOSE_TIMEOUT_S", 0.05)
    with hanging(opened.submit):
        accepted = sum(opened.submit(lambda _session: None) for _ in range(session_module.MAX_JOBS + 10))
        assert not opened.close()
    assert session_module.MAX_JOBS - 1 <= accepted <= session_module.MAX_JOBS


def test_a_failed_session_is_opened_again(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(session_module, "RETRY_PERIOD_S", 0.01)
    tries = iter([*[zenoh.ZError("no router at /a/line/of/zenoh")] * 2, None])

    def open_later() -> zenoh.Session:
        error = next(tries)
        if error is not None:
            raise error
        return open_session()

    thread = SessionThread(open_later)
    thread.start()
    assert thread.opened.result(TIMEOUT_S)
    message = "zenoh: not open yet: no router; trying again every 0.01 s"
    assert [record.message for record in caplog.records] == [message]
    assert thread.close()


def test_a_session_that_never_opens_does_not_hold_up_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_module, "RETRY_PERIOD_S", 10 * session_module.CLOSE_TIMEOUT_S)

    def open_never() -> zenoh.Session:
        raise zenoh.ZError("no router")

    thread = SessionThread(open_never)
    thread.start()
    assert thread.close()


@pytest.fixture
async def taken() -> list[int]:
    """What the event loop has taken out of the queue."""
    return []


@pytest.fixture
async def box(taken: list[int]) -> ReceiveQueue[int]:
    return ReceiveQueue[int](asyncio.get_running_loop(), taken.append)


async def test_items_of_other_threads_come_to_the_loop_in_order(box: ReceiveQueue[int], taken: list[int]) -> None:
    await asyncio.to_thread(lambda: [box.put(number, 1) for number in range(100)])
    await until(lambda: len(taken) == 100)
    assert taken == list(range(100))
    assert box.dropped == 0


HALF_BYTES = session_module.MAX_WAITING_BYTES // 2


@pytest.mark.parametrize(
    ("count", "size_bytes", "kept"),
    [(session_module.MAX_WAITING + 5, 1, session_module.MAX_WAITING), (3, HALF_BYTES, 2)],
    ids=["too many", "too large"],
)
async def test_of_more_items_than_fit_the_newest_are_kept(
    box: ReceiveQueue[int], taken: list[int], count: int, size_bytes: int, kept: int
) -> None:
    for number in range(count):
        box.put(number, size_bytes)
    await until(lambda: len(taken) >= kept)
    assert taken == list(range(count - kept, count))
    assert box.dropped == count - kept


async def test_a_full_inbox_lets_others_have_their_turn(box: ReceiveQueue[int], taken: list[int]) -> None:
    for number in range(3 * session_module.ITEMS_AT_A_TIME):
        box.put(number, 1)
    await asyncio.sleep(0)
    assert len(taken) <= session_module.ITEMS_AT_A_TIME


def test_items_after_the_end_of_the_loop_are_dropped_silently() -> None:
    loop = asyncio.new_event_loop()
    box = ReceiveQueue[int](loop, lambda _item: None)
    loop.close()
    box.put(1, 1)
