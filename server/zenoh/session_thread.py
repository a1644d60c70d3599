"""The threads that have the zenoh session: a slow network holds up nothing but itself.

Zenoh's calls wait for one another, and requests and responses for a machine that does not read them, until it is
let go; messages on topics do not, they are dropped. So there is a thread for either; the event loop leaves jobs and
goes on.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

from server.zenoh.session_config import sentence

if TYPE_CHECKING:
    import zenoh

log = logging.getLogger("armbridge.zenoh")

Job: TypeAlias = "Callable[[zenoh.Session], object]"

# A job for each topic that has messages, and one for each call on its way: more means that the network stands still.
MAX_JOBS = 10_000

# What is left of requests and responses when the server ends has this long; a machine that does not read loses them.
CALLS_END_TIMEOUT_S = 0.1

# A router that is not up yet, or an address that is still taken.
RETRY_PERIOD_S = 2.0

# A server is to end within three seconds; this takes some ten milliseconds, unless the network stands still.
CLOSE_TIMEOUT_S = 0.4


class SessionThread:
    """Opens a session, does what it is told with it, and closes it.

    Args:
        open_session: opens the session; tried again for as long as it fails with ``zenoh.ZError``.
        opened: called with the session's id when it is open, in this thread.
    """

    def __init__(self, open_session: Callable[[], zenoh.Session], opened: Callable[[str], None]) -> None:
        self._open_session = open_session
        self._opened = opened
        self._jobs: queue.Queue[Job] = queue.Queue(MAX_JOBS)
        self._calls: queue.Queue[Job] = queue.Queue(MAX_JOBS)
        self._closing = threading.Event()
        self._refused = 0
        self._thread = threading.Thread(target=self._run, name="zenoh", daemon=True)

    @property
    def refused(self) -> int:
        """How many jobs found no room."""
        return self._refused

    def start(self) -> None:
        """Begin to open the session."""
        self._thread.start()

    def do(self, job: Job) -> bool:
        """Have something done soon; never waits. Returns False when there is no room for it."""
        return self._put(self._jobs, job)

    def do_call(self, job: Job) -> bool:
        """As :meth:`do`, for requests and responses."""
        return self._put(self._calls, job)

    def close(self) -> bool:
        """Do what was left before, and close the session; returns whether that was done in time."""
        self._closing.set()
        for jobs in (self._jobs, self._calls):
            self._put(jobs, lambda _session: None)
        self._thread.join(CLOSE_TIMEOUT_S)
        return not self._thread.is_alive()

    def _put(self, jobs: queue.Queue[Job], job: Job) -> bool:
        try:
            jobs.put_nowait(job)
        except queue.Full:
            self._refused += 1
            return False
        return True

    def _run(self) -> None:
        session = self._open()
        if session is None:
            return
        calls = threading.Thread(target=self._work, args=(session, self._calls), name="zenoh calls", daemon=True)
        calls.start()
        try:
            self._opened(str(session.zid()))
            self._work(session, self._jobs)
        finally:
            calls.join(CALLS_END_TIMEOUT_S)
            session.close()

    def _open(self) -> zenoh.Session | None:
        """Open the session, however long that takes; None when it is to be closed meanwhile."""
        import zenoh

        told = ""
        while not self._closing.is_set():
            try:
                return self._open_session()
            except zenoh.ZError as error:
                if sentence(error) != told:
                    told = sentence(error)
                    log.warning("zenoh: not open yet: %s; trying again every %g s", told, RETRY_PERIOD_S)
            self._closing.wait(RETRY_PERIOD_S)
        return None

    def _work(self, session: zenoh.Session, jobs: queue.Queue[Job]) -> None:
        import zenoh

        while not (self._closing.is_set() and jobs.empty()):
            job = jobs.get()
            try:
                job(session)
            except zenoh.ZError as error:
                log.warning("zenoh: %s", sentence(error))
            except Exception:  # a bug in one job must not end the others
                log.exception("zenoh: a job failed")
