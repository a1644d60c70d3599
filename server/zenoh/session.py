"""The zenoh session's threads, and the way from them to the event loop: a slow network blocks nothing but itself."""

import asyncio
import logging
import queue
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeAlias, TypeVar

import zenoh

from server.timers import call_in_loop
from server.zenoh.settings import error_text

log = logging.getLogger("armbridge.zenoh")

Job: TypeAlias = Callable[[zenoh.Session], object]
Item = TypeVar("Item")

# One job for each topic that has messages, and one for each call in progress: more means that the network is stuck.
MAX_JOBS = 10_000

# Time for remaining requests and responses when the server stops; a machine that does not read loses them.
CALLS_END_TIMEOUT_S = 0.1

# A router may not be up yet, or an address may still be in use.
RETRY_PERIOD_S = 2.0

# The server has three seconds to stop; this takes some ten milliseconds, unless the network is stuck.
CLOSE_TIMEOUT_S = 0.4

# Items that may wait while the event loop is busy; beyond that the oldest are dropped.
MAX_WAITING = 500
MAX_WAITING_BYTES = 33_554_432

# Items taken in one turn of the event loop, so that clients are served in between.
ITEMS_AT_A_TIME = 20


class SessionThread:
    """Threads that open a session, carry out jobs with it, and close it.

    zenoh's calls wait for one another, and requests and responses wait for a machine that does not read them until its
    link is closed; messages on topics do not, they are dropped. So there is a thread for either. Opening is repeated as
    long as it raises ``zenoh.ZError``; ``opened`` is the session's id.
    """

    def __init__(self, open_session: Callable[[], zenoh.Session]) -> None:
        self.opened: Future[str] = Future()
        # Those who give up waiting for it cannot cancel it.
        self.opened.set_running_or_notify_cancel()
        self._open_session = open_session
        self._jobs: queue.Queue[Job] = queue.Queue(MAX_JOBS)
        self._calls: queue.Queue[Job] = queue.Queue(MAX_JOBS)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="zenoh", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def submit(self, job: Job) -> bool:
        """Queue a job; never waits. Returns False if there is no room for it."""
        return self._put(self._jobs, job)

    def submit_call(self, job: Job) -> bool:
        """Queue a job that sends a request or response, as :meth:`submit`."""
        return self._put(self._calls, job)

    def close(self) -> bool:
        """Finish the queued jobs and close the session; returns False if that takes longer than `CLOSE_TIMEOUT_S`."""
        self._closing.set()
        for jobs in (self._jobs, self._calls):
            self._put(jobs, lambda _session: None)
        self._thread.join(CLOSE_TIMEOUT_S)
        return not self._thread.is_alive()

    def _put(self, jobs: queue.Queue[Job], job: Job) -> bool:
        try:
            jobs.put_nowait(job)
        except queue.Full:
            return False
        return True

    def _run(self) -> None:
        session = self._open()
        if session is None:
            return
        calls = threading.Thread(target=self._work, args=(session, self._calls), name="zenoh calls", daemon=True)
        calls.start()
        try:
            self.opened.set_result(str(session.zid()))
            self._work(session, self._jobs)
        finally:
            calls.join(CALLS_END_TIMEOUT_S)
            session.close()

    def _open(self) -> zenoh.Session | None:
        """Open the session, however long that takes; returns None if it is closed meanwhile."""
        logged = ""
        while not self._closing.is_set():
            try:
                return self._open_session()
            except zenoh.ZError as error:
                if error_text(error) != logged:
                    logged = error_text(error)
                    log.warning("zenoh: not open yet: %s; trying again every %g s", logged, RETRY_PERIOD_S)
            self._closing.wait(RETRY_PERIOD_S)
        return None

    def _work(self, session: zenoh.Session, jobs: queue.Queue[Job]) -> None:
        while not (self._closing.is_set() and jobs.empty()):
            job = jobs.get()
            try:
                job(session)
            except zenoh.ZError as error:
                log.warning("zenoh: %s", error_text(error))
            except Exception:  # a bug in one job must not end the others
                log.exception("zenoh: a job failed")


class ReceiveQueue(Generic[Item]):
    """Bounded queue from zenoh's threads to the event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop, handle: Callable[[Item], None]) -> None:
        self._loop = loop
        self._handle = handle
        self._lock = threading.Lock()
        self._waiting: deque[tuple[Item, int]] = deque()
        self._waiting_bytes = 0
        # The newest item of each kind that goes ahead.
        self._ahead: dict[str, Item] = {}
        self._scheduled = False
        self.dropped = 0

    def put(self, item: Item, size_bytes: int, *, ahead_as: str = "") -> None:
        """Add an item, from any thread; never waits. It goes ahead as the newest of a kind, if one is named."""
        with self._lock:
            if ahead_as:
                self._ahead[ahead_as] = item
            else:
                self._waiting.append((item, size_bytes))
                self._waiting_bytes += size_bytes
            while len(self._waiting) > MAX_WAITING or self._waiting_bytes > MAX_WAITING_BYTES:
                self._waiting_bytes -= self._waiting.popleft()[1]
                self.dropped += 1
            scheduled, self._scheduled = self._scheduled, True
        if not scheduled:
            call_in_loop(self._loop, self._handle_some)

    def _handle_some(self) -> None:
        with self._lock:
            taken = [self._waiting.popleft() for _ in range(min(ITEMS_AT_A_TIME, len(self._waiting)))]
            self._waiting_bytes -= sum(size_bytes for _, size_bytes in taken)
            ahead, self._ahead = self._ahead, {}
        for item in (*ahead.values(), *(item for item, _ in taken)):
            self._handle(item)
        with self._lock:
            self._scheduled = bool(self._waiting or self._ahead)
        if self._scheduled:
            self._loop.call_soon(self._handle_some)
