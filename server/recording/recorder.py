"""Recording of every message that is published on the graph, written to a file by a thread."""

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from protocol.codecs import cdr
from protocol.publication import PublishedMessage
from robot.logs import LogLimiter
from server.config import RecordingSettings
from server.errors import StartError
from server.graph.topics import Graph
from server.recording.files import RecordedMessage, RecordingFile

log = logging.getLogger("armbridge.recording")

BYTES_PER_MB = 1_000_000

# Messages and bytes that may wait for the disk: seconds of everything an arm publishes, and a few images.
MAX_QUEUED_MESSAGES = 20_000
MAX_QUEUED_BYTES = 33_554_432

# Polling at this period costs nothing; waking the thread for each message would cost the event loop more.
POLL_PERIOD_S = 0.05

# The last seconds of a recording that a killed process may lose.
FLUSH_PERIOD_S = 1.0

# Both threads share one interpreter: after this number of messages, some 20 us each, the event loop gets it.
MESSAGES_AT_A_TIME = 10
PAUSE_S = 0.0002

DROPS_LOG_PERIOD_S = 10.0

# The server has three seconds to stop.
CLOSE_TIMEOUT_S = 2.0


class Recorder:
    """Records a graph from its construction to :meth:`close`; messages wait in memory until :meth:`start`.

    A thread writes them, so that neither disk nor compression blocks the event loop. An error ends the recording, and
    nothing else.

    Attributes:
        dropped: messages missing because the file could not be written fast enough.
    """

    def __init__(
        self, graph: Graph, path: Path, settings: RecordingSettings, clock: Callable[[], float] | None = None
    ) -> None:
        """Take messages; the clock gives seconds since the epoch that never go back, None for the machine's."""
        self._graph = graph
        self._registry = graph.message_types.registry
        self._path = path
        self._settings = settings
        self._clock = clock
        # The machine's clock, when it is set during a recording, would tear a gap into it.
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._unknown_types = LogLimiter()
        # Each with its size [bytes], True for a latched one, and its time of recording [ns].
        self._queue: deque[tuple[PublishedMessage, int, bool, int]] = deque()
        # Each is changed by one thread only; their difference is the size of the queue.
        self._put_bytes = 0
        self._written_bytes = 0
        self.dropped = 0
        self._stopping = threading.Event()
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        graph.watch(self._record)

    def start(self) -> None:
        """Open the file, and write to it from now on."""
        limit_bytes = None if self._settings.limit_mb is None else self._settings.limit_mb * BYTES_PER_MB
        try:
            file = RecordingFile(self._path, self._registry, limit_bytes)
        except OSError as error:
            raise StartError(f"recording.file: {self._path} cannot be written: {error.strerror or error}") from error
        self._thread = threading.Thread(target=self._write, args=(file,), name="recording", daemon=True)
        self._thread.start()

    @property
    def ended(self) -> bool:
        """True once nothing more is recorded, after an error too."""
        return self._ended.is_set()

    async def close(self) -> None:
        """Stop recording, write the queued messages, and end the file; there is none without :meth:`start`."""
        self._graph.unwatch(self._record)
        self._stopping.set()
        if self._thread is None:
            self._ended.set()
            return
        await asyncio.to_thread(self._thread.join, CLOSE_TIMEOUT_S)
        if self._thread.is_alive():
            log.error("recording: %s was not ended within %g s; its content can be read", self._path, CLOSE_TIMEOUT_S)

    def _record(self, published: PublishedMessage, latched: bool) -> None:
        """Queue a message, or count it as dropped; never waits."""
        if self.ended:
            return
        if not self._registry.knows(published.type_name):
            line = f"recording: {published.topic} is left out, the type {published.type_name} is unknown"
            self._unknown_types.write(log, logging.WARNING, line, published.type_name)
            return
        log_time_ns = self._epoch_ns + time.monotonic_ns() if self._clock is None else round(1e9 * self._clock())
        size_bytes = published.size_bytes
        queued_bytes = self._put_bytes - self._written_bytes
        if len(self._queue) >= MAX_QUEUED_MESSAGES or queued_bytes + size_bytes > MAX_QUEUED_BYTES:
            self.dropped += 1
            return
        self._put_bytes += size_bytes
        self._queue.append((published, size_bytes, latched, log_time_ns))

    # The thread.

    def _write(self, file: RecordingFile) -> None:
        try:
            self._write_until_stopped(file)
            file.end()
        except OSError as error:
            file.abandon()
            log.error(  # noqa: TRY400 - what matters is the sentence
                "recording ended: %s cannot be written any further: %s", file.path, error.strerror or error
            )
        else:
            log.info("recording ended: %s", file.path)
        finally:
            self._ended.set()
            self._queue.clear()

    def _write_until_stopped(self, file: RecordingFile) -> None:
        flush_at_s = time.monotonic() + FLUSH_PERIOD_S
        stopping, dropped_logged, drops_logged_at_s = False, 0, -DROPS_LOG_PERIOD_S
        # Once more after the stop, for messages that came until then.
        while not stopping:
            stopping = self._stopping.wait(POLL_PERIOD_S)
            # The messages that are in the queue now; later ones have the next round.
            for number in range(len(self._queue)):
                if file.full:
                    log.warning("recording: %s has the size of recording.limit_mb", file.path)
                    return
                if number % MESSAGES_AT_A_TIME == MESSAGES_AT_A_TIME - 1:
                    time.sleep(PAUSE_S)
                published, size_bytes, latched, log_time_ns = self._queue.popleft()
                octets = cdr.serialize(self._registry, published.type_name, published.msg)
                times = log_time_ns, published.received.sec * 1_000_000_000 + published.received.nanosec
                file.add(RecordedMessage(published.topic, published.type_name, latched, *times, octets))
                self._written_bytes += size_bytes
            now_s = time.monotonic()
            if now_s >= flush_at_s:
                file.flush()
                flush_at_s = now_s + FLUSH_PERIOD_S
            if self.dropped > dropped_logged and now_s - drops_logged_at_s >= DROPS_LOG_PERIOD_S:
                dropped, dropped_logged, drops_logged_at_s = self.dropped - dropped_logged, self.dropped, now_s
                log.warning("recording: %d messages were dropped, the disk or the processor is too slow", dropped)
