"""Recording of every message that is published on the graph, written to files by a thread."""

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from protocol.codecs import cdr
from protocol.publication import PublishedMessage
from protocol.registry import Registry
from robot.logs import LogLimiter
from server.config import RecordingSettings
from server.errors import StartError
from server.graph.topics import Graph
from server.recording.files import RecordedMessage, RecordingSeries

log = logging.getLogger("armbridge.recording")

BYTES_PER_MB = 1_000_000

# Messages and bytes that may wait for the disk: seconds of everything an arm publishes, and a few images.
MAX_QUEUED_MESSAGES = 20_000
MAX_QUEUED_BYTES = 33_554_432

# Polling so often costs nothing; waking the thread for each message would cost the event loop more.
POLL_PERIOD_S = 0.05

# A process that is killed loses at most so much of the recording.
FLUSH_PERIOD_S = 1.0

# Both threads share one interpreter: after this number of messages, some 20 us each, the event loop gets it.
MESSAGES_AT_A_TIME = 10
PAUSE_S = 0.0002

DROPS_LOG_PERIOD_S = 10.0

# The server has three seconds to stop.
CLOSE_TIMEOUT_S = 2.0


class Recorder:
    """Records a graph from its construction to :meth:`close`; messages wait in memory until :meth:`start`."""

    def __init__(
        self,
        graph: Graph,
        path: Path,
        settings: RecordingSettings,
        facts: dict[str, str] | None = None,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        wall_clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._graph = graph
        self._registry = graph.message_types.registry
        self._path = path
        self._settings = settings
        self._facts = facts or {}
        self._clock_ns = clock_ns
        # A wall clock that is set during a recording would tear a gap into it.
        self._epoch_ns = wall_clock_ns() - clock_ns()
        self._unknown_types = LogLimiter()
        self._writer = WriterThread(self._registry)
        graph.watch(self._record)

    def start(self) -> None:
        """Open the file, and write to it from now on."""
        limit_bytes = None if self._settings.limit_mb is None else self._settings.limit_mb * BYTES_PER_MB
        try:
            files = RecordingSeries(self._path, self._registry, self._facts, limit_bytes, self._settings.keep_files)
        except OSError as error:
            raise StartError(f"recording.file: {self._path} cannot be written: {error.strerror or error}") from error
        self._writer.start(files)

    @property
    def dropped(self) -> int:
        """Messages missing because the file could not be written fast enough."""
        return self._writer.dropped

    @property
    def queued(self) -> int:
        return self._writer.queued

    @property
    def ended(self) -> bool:
        """True once nothing more is recorded, after an error too."""
        return self._writer.ended

    async def close(self) -> None:
        """Stop recording, and end the file; there is none without :meth:`start`."""
        self._graph.unwatch(self._record)
        if not await asyncio.to_thread(self._writer.close):
            log.error("recording: %s was not ended within %g s; its content can be read", self._path, CLOSE_TIMEOUT_S)

    def _record(self, published: PublishedMessage, latched: bool) -> None:
        if self._writer.ended:
            return
        if not self._registry.knows(published.type_name):
            line = f"recording: {published.topic} is left out, the type {published.type_name} is unknown"
            self._unknown_types.write(log, logging.WARNING, line, published.type_name)
            return
        log_time_ns = self._epoch_ns + self._clock_ns()
        self._writer.put(QueuedMessage(published, latched, published.size_bytes, log_time_ns))


class QueuedMessage(NamedTuple):
    """Message that waits to be written."""

    published: PublishedMessage
    latched: bool
    size_bytes: int
    log_time_ns: int


class WriterThread:
    """Thread that writes queued messages, so that neither disk nor compression blocks the event loop.

    An error ends the recording, and nothing else.
    """

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._queue: deque[QueuedMessage] = deque()
        # Each is changed by one thread only; their difference is the size of the queue.
        self._put_bytes = 0
        self._written_bytes = 0
        self.dropped = 0
        self._dropped_logged = 0
        self._drops_logged_at_s = -DROPS_LOG_PERIOD_S
        self._stopping = threading.Event()
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def queued(self) -> int:
        return len(self._queue)

    @property
    def ended(self) -> bool:
        """True once nothing more will be written."""
        return self._ended.is_set()

    def start(self, files: RecordingSeries) -> None:
        self._thread = threading.Thread(target=self._run, args=(files,), name="recording", daemon=True)
        self._thread.start()

    def put(self, message: QueuedMessage) -> None:
        """Queue a message, or count it as dropped; never waits."""
        queued_bytes = self._put_bytes - self._written_bytes
        if len(self._queue) >= MAX_QUEUED_MESSAGES or queued_bytes + message.size_bytes > MAX_QUEUED_BYTES:
            self.dropped += 1
            return
        self._put_bytes += message.size_bytes
        self._queue.append(message)

    def close(self) -> bool:
        """Write the queued messages and end the file; returns False if that takes longer than `CLOSE_TIMEOUT_S`."""
        if self._thread is None:
            self._ended.set()
            return True
        self._stopping.set()
        self._thread.join(CLOSE_TIMEOUT_S)
        return not self._thread.is_alive()

    def _run(self, files: RecordingSeries) -> None:
        try:
            self._write_until_stopped(files)
            files.end({"dropped_messages": str(self.dropped)})
        except OSError as error:
            files.abandon()
            log.error(  # noqa: TRY400 - what matters is the sentence
                "recording ended: %s cannot be written any further: %s", files.path, error.strerror or error
            )
        else:
            log.info("recording ended: %s", files.path)
        finally:
            self._ended.set()
            self._queue.clear()

    def _write_until_stopped(self, files: RecordingSeries) -> None:
        flush_at_s = time.monotonic() + FLUSH_PERIOD_S
        stopping = False
        # Once more after the stop, for messages that came until then.
        while not stopping:
            stopping = self._stopping.wait(POLL_PERIOD_S)
            # The messages that are in the queue now; later ones have the next round.
            for number in range(len(self._queue)):
                if number % MESSAGES_AT_A_TIME == MESSAGES_AT_A_TIME - 1:
                    time.sleep(PAUSE_S)
                message = self._queue.popleft()
                published = message.published
                octets = cdr.serialize(self._registry, published.type_name, published.msg)
                publish_time_ns = published.received.sec * 1_000_000_000 + published.received.nanosec
                times = message.log_time_ns, publish_time_ns
                files.add(RecordedMessage(published.topic, published.type_name, message.latched, *times, octets))
                self._written_bytes += message.size_bytes
            now_s = time.monotonic()
            if now_s >= flush_at_s:
                files.flush()
                flush_at_s = now_s + FLUSH_PERIOD_S
            if self.dropped > self._dropped_logged and now_s - self._drops_logged_at_s >= DROPS_LOG_PERIOD_S:
                log.warning(
                    "recording: %d messages were dropped, the disk or the processor is too slow",
                    self.dropped - self._dropped_logged,
                )
                self._dropped_logged, self._drops_logged_at_s = self.dropped, now_s
