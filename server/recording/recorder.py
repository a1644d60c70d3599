"""Records every message that is published on the graph."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from pathlib import Path

from protocol.publication import Publication
from server.errors import StartError
from server.graph.topics import Graph
from server.recording.file_series import FileSeries
from server.recording.writer_thread import CLOSE_TIMEOUT_S, Taken, WriterThread

log = logging.getLogger("armbridge.recording")

# Types that only clients know; each is told once, and a client that invents them is not.
MAX_TOLD_TYPES = 100

BYTES_PER_MB = 1_000_000


class Recorder:
    """Takes messages from the graph to the thread that writes them.

    Args:
        graph: what is recorded.
        path: the file; where it exists, a number is added to its name.
        limit_mb: size of a file from which on the next one is begun [MB]; None for no limit.
        keep_files: how many files of this recording are kept, the newest; 0 for all.
        facts: what else each file is to tell.
        clock_ns: monotonic time [ns].
        wall_clock_ns: time since the epoch [ns].
    """

    def __init__(
        self,
        graph: Graph,
        path: Path,
        limit_mb: int | None = None,
        keep_files: int = 0,
        facts: dict[str, str] | None = None,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        wall_clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._graph = graph
        self._registry = graph.interfaces.registry
        self._path = path
        self._limit_bytes = None if limit_mb is None else limit_mb * BYTES_PER_MB
        self._keep_files = keep_files
        self._facts = facts or {}
        self._clock_ns = clock_ns
        # A wall clock that is set while a recording runs would tear a hole into it.
        self._epoch_ns = wall_clock_ns() - clock_ns()
        self._told_types: set[str] = set()
        self._writer: WriterThread | None = None

    @property
    def dropped(self) -> int:
        """How many messages are missing because the file could not be written fast enough."""
        return 0 if self._writer is None else self._writer.dropped

    @property
    def queued(self) -> int:
        """How many messages wait to be written."""
        return 0 if self._writer is None else self._writer.queued

    @property
    def ended(self) -> bool:
        """Whether nothing more is recorded, be it by an error."""
        return self._writer is None or self._writer.ended

    def open(self) -> None:
        """Begin the file and record from now on.

        Raises:
            StartError: the file cannot be written.
        """
        try:
            files = FileSeries(self._path, self._registry, self._facts, self._limit_bytes, self._keep_files)
        except OSError as error:
            raise StartError(f"recording.file: {self._path} cannot be written: {error.strerror or error}") from error
        self._writer = WriterThread(files, self._registry)
        self._writer.start()
        self._graph.watch(self._take)

    async def close(self) -> None:
        """Record no more, and end the file."""
        self._graph.unwatch(self._take)
        if self._writer is not None and not await asyncio.to_thread(self._writer.close):
            log.error("recording: %s was not ended within %g s; what is in it can be read", self._path, CLOSE_TIMEOUT_S)

    def _take(self, publication: Publication, latched: bool) -> None:
        if self._writer is None or self._writer.ended:
            return
        if not self._registry.knows(publication.type_name):
            self._tell_unknown(publication)
            return
        log_time_ns = self._epoch_ns + self._clock_ns()
        self._writer.put(Taken(publication, latched, publication.size_bytes, log_time_ns))

    def _tell_unknown(self, publication: Publication) -> None:
        name = publication.type_name
        if name not in self._told_types and len(self._told_types) < MAX_TOLD_TYPES:
            self._told_types.add(name)
            log.warning("recording: %s is left out, the type %s is unknown", publication.topic, name)
