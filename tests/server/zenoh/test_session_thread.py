"""Sessions are real ones; none of them connects anywhere."""

from __future__ import annotations

import contextlib
import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator

import pytest
import zenoh

from server.zenoh import session_thread
from server.zenoh.session_config import session_config
from server.zenoh.session_thread import SessionThread
from server.zenoh.settings import ZenohSettings


def open_session() -> zenoh.Session:
    return zenoh.open(session_config(ZenohSettings(mode="peer")))


TIMEOUT_S = 30.0


@contextlib.contextmanager
def hanging(do: Callable[[session_thread.Job], bool]) -> Iterator[None]:
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
        self.sessions: queue.Queue[str] = queue.Queue()
        self.thread = SessionThread(open_session, self.sessions.put)

    def wait(self) -> str:
        return self.sessions.get(timeout=TIMEOUT_S)


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
        assert opened.thread.do(lambda session, number=number: done.put((number, session.is_closed())))
    assert [done.get(timeout=TIMEOUT_S) for _ in range(3)] == [(0, False), (1, False), (2, False)]


def test_a_job_that_fails_ends_no_other(opened: Opened, caplog: pytest.LogCaptureFixture) -> None:
    done = threading.Event()

    def fail(_session: zenoh.Session) -> None:
        raise RuntimeError("a bug")

    opened.thread.do(lambda session: session.put("not//a/key", b""))
    opened.thread.do(fail)
    opened.thread.do(lambda _session: done.set())
    assert done.wait(TIMEOUT_S)
    assert [record.levelno for record in caplog.records] == [logging.WARNING, logging.ERROR]


def test_what_was_left_before_the_end_is_done(opened: Opened) -> None:
    done = threading.Event()
    opened.thread.do(lambda _session: time.sleep(0.05))
    opened.thread.do(lambda _session: done.set())
    assert opened.thread.close()
    assert done.is_set()


def test_a_call_that_waits_for_its_machine_holds_up_no_topic(opened: Opened) -> None:
    done = threading.Event()
    with hanging(opened.thread.do_call):
        opened.thread.do(lambda _session: done.set())
        assert done.wait(TIMEOUT_S)


def test_a_call_that_waits_for_its_machine_does_not_hold_up_the_end(opened: Opened) -> None:
    with hanging(opened.thread.do_call):
        assert opened.thread.close()


def test_a_network_that_stands_still_holds_up_neither_work_nor_the_end(
    opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session_thread, "CLOSE_TIMEOUT_S", 0.05)
    with hanging(opened.thread.do):
        accepted = sum(opened.thread.do(lambda _session: None) for _ in range(session_thread.MAX_JOBS + 10))
        assert not opened.thread.close()
    assert session_thread.MAX_JOBS - 1 <= accepted <= session_thread.MAX_JOBS
    assert opened.thread.refused >= 9


def test_a_session_that_cannot_be_opened_is_tried_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(session_thread, "RETRY_PERIOD_S", 0.01)
    tries = iter([zenoh.ZError("no router at /a/line/of/zenoh"), zenoh.ZError("no router at /a/line/of/zenoh"), None])
    sessions: queue.Queue[str] = queue.Queue()

    def open_later() -> zenoh.Session:
        error = next(tries)
        if error is not None:
            raise error
        return open_session()

    thread = SessionThread(open_later, sessions.put)
    thread.start()
    assert sessions.get(timeout=TIMEOUT_S)
    assert [record.message for record in caplog.records] == [
        "zenoh: not open yet: no router; trying again every 0.01 s"
    ]
    assert thread.close()


def test_a_session_that_never_opens_does_not_hold_up_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_thread, "RETRY_PERIOD_S", 10 * session_thread.CLOSE_TIMEOUT_S)

    def open_never() -> zenoh.Session:
        raise zenoh.ZError("no router")

    thread = SessionThread(open_never, lambda _session: None)
    thread.start()
    assert thread.close()
