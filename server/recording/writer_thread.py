"""The thread that writes a recording, so that neither a disk nor compression holds up the event loop."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from protocol.codecs import cdr
from protocol.publication import Publication
from protocol.registry import Registry
from server.recording.file_series import FileSeries
from server.recording.mcap_file import Entry

log = logging.getLogger("armbridge.recording")

# What a disk may be behind: seconds of everything an arm says, and a few pictures.
MAX_QUEUED_MESSAGES = 20_000
MAX_QUEUED_BYTES = 33_554_432

# Looking so often costs nothing, and waking the thread for each message would cost the event loop more.
LOOK_PERIOD_S = 0.05

# What the end of the process, in whatever way, takes with it.
FLUSH_PERIOD_S = 1.0

# Both threads share one interpreter: after so many messages, some 20 us each, the event loop gets it for a moment.
MESSAGES_AT_A_TIME = 10
PAUSE_S = 0.0002

DROPS_TOLD_PERIOD_S = 10.0

# A server is to end within three seconds.
CLOSE_TIMEOUT_S = 2.0


class Taken(NamedTuple):
    """A message on its way to the file: what was published, whether latched, how large, and when [ns]."""

    publication: Publication
    latched: bool
    size_bytes: int
    log_time_ns: int


class WriterThread:
    """Writes what is put into its queue; an error ends the recording, and nothing else.

    Args:
        files: where to.
        registry: types.
        clock: monotonic time [s].
    """

    def __init__(self, files: FileSeries, registry: Registry, clock: Callable[[], float] = time.monotonic) -> None:
        self._files = files
        self._registry = registry
        self._clock = clock
        self._queue: deque[Taken] = deque()
        # Each is written by one thread alone; the difference is what is queued.
        self._put_bytes = 0
        self._done_bytes = 0
        self._dropped = 0
        self._dropped_told = 0
        self._told_at_s = -DROPS_TOLD_PERIOD_S
        self._stopping = threading.Event()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)

    @property
    def dropped(self) -> int:
        """How many messages found no room in the queue."""
        return self._dropped

    @property
    def queued(self) -> int:
        """How many messages wait to be written."""
        return len(self._queue)

    @property
    def ended(self) -> bool:
        """Whether nothing more will be written."""
        return self._ended.is_set()

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def put(self, taken: Taken) -> None:
        """Queue a message, or count it as dropped; never waits."""
        queued_bytes = self._put_bytes - self._done_bytes
        if len(self._queue) >= MAX_QUEUED_MESSAGES or queued_bytes + taken.size_bytes > MAX_QUEUED_BYTES:
            self._dropped += 1
            return
        self._put_bytes += taken.size_bytes
        self._queue.append(taken)

    def close(self) -> bool:
        """Write what is queued and end the file; returns whether that was done in time."""
        self._stopping.set()
        self._thread.join(CLOSE_TIMEOUT_S)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._write_until_told()
            self._files.end({"dropped_messages": str(self._dropped)})
        except OSError as error:
            self._files.give_up()
            log.error(  # noqa: TRY400 - what matters is the sentence
                "recording ended: %s cannot be written any further: %s", self._files.path, error.strerror or error
            )
        else:
            log.info("recording ended: %s", self._files.path)
        finally:
            self._ended.set()
            self._queue.clear()

    def _write_until_told(self) -> None:
        flush_at_s = self._clock() + FLUSH_PERIOD_S
        stopping = False
        # Once more after being told, for what came until then.
        while not stopping:
            stopping = self._stopping.wait(LOOK_PERIOD_S)
            self._write_queued()
            if self._clock() >= flush_at_s:
                self._files.flush()
                flush_at_s = self._clock() + FLUSH_PERIOD_S
            self._tell_drops()

    def _write_queued(self) -> None:
        """Write what is in the queue now; what comes meanwhile is next."""
        for number in range(len(self._queue)):
            if number % MESSAGES_AT_A_TIME == MESSAGES_AT_A_TIME - 1:
                time.sleep(PAUSE_S)
            taken = self._queue.popleft()
            self._files.add(self._entry(taken))
            self._done_bytes += taken.size_bytes

    def _entry(self, taken: Taken) -> Entry:
        publication = taken.publication
        octets = cdr.serialize(self._registry, publication.type_name, publication.msg)
        published_ns = publication.received.sec * 1_000_000_000 + publication.received.nanosec
        return Entry(publication.topic, publication.type_name, taken.latched, taken.log_time_ns, published_ns, octets)

    def _tell_drops(self) -> None:
        now_s = self._clock()
        if self._dropped > self._dropped_told and now_s - self._told_at_s >= DROPS_TOLD_PERIOD_S:
            log.warning(
                "recording: %d messages were dropped, the disk or the processor is too slow for what is published",
                self._dropped - self._dropped_told,
            )
            self._dropped_told, self._told_at_s = self._dropped, now_s
