"""The files of one recording: a new one when the last has its size, the oldest given up when there are too many."""

from __future__ import annotations

import contextlib
import logging
from collections import deque
from pathlib import Path
from typing import BinaryIO

from protocol.registry import Registry
from server.recording.mcap_file import Entry, McapFile

log = logging.getLogger("armbridge.recording")

# No file is ever written over; a directory with more recordings of one name is a mistake.
MAX_NUMBER = 100_000

# What every file of a series begins with, if it is to be of use alone: descriptions, static transforms.
MAX_LATCHED_BYTES = 67_108_864


class FileSeries:
    """Files ``NAME.mcap``, ``NAME_1.mcap``, ``NAME_2.mcap``, of which none existed before.

    Everything here may raise OSError.

    Args:
        path: the first of them.
        registry: types.
        facts: what each file is to tell.
        limit_bytes: a file that has so much is ended, and the next one begun; None for no limit.
        keep: of this recording, so many files are kept, the newest; 0 for all.
    """

    def __init__(
        self, path: Path, registry: Registry, facts: dict[str, str], limit_bytes: int | None, keep: int
    ) -> None:
        self._path = path
        self._registry = registry
        self._facts = facts
        self._limit_bytes = limit_bytes
        self._keep = keep
        self._number = 0
        self._written: deque[Path] = deque()
        self._latched: dict[str, Entry] = {}
        self._latched_bytes = 0
        self._file = self._begin()

    @property
    def path(self) -> Path:
        """The file that is being written."""
        return self._written[-1]

    def add(self, entry: Entry) -> None:
        """Append a message."""
        if self._limit_bytes is not None:
            if self._file.size_bytes >= self._limit_bytes:
                self._file.end({})
                self._file = self._begin()
                self._repeat_latched(entry.log_time_ns)
            if entry.latched:
                self._remember(entry)
        self._file.add(entry)

    def flush(self) -> None:
        """Bring everything to the file."""
        self._file.flush()

    def end(self, facts: dict[str, str]) -> None:
        """End the last file in good order, with facts that are known only now."""
        self._file.end(facts)

    def give_up(self) -> None:
        """Close the file as it is, after an error."""
        # What is still buffered meets the same error again.
        with contextlib.suppress(OSError):
            self._stream.close()

    def _begin(self) -> McapFile:
        self._stream, path = self._open_next()
        self._written.append(path)
        if self._keep and len(self._written) > self._keep:
            self._written.popleft().unlink(missing_ok=True)
        log.info("recording to %s", path)
        try:
            return McapFile(self._stream, self._registry, self._facts)
        except OSError:
            self.give_up()
            raise

    def _open_next(self) -> tuple[BinaryIO, Path]:
        while self._number < MAX_NUMBER:
            number, self._number = self._number, self._number + 1
            path = self._path.with_stem(f"{self._path.stem}_{number}") if number else self._path
            with contextlib.suppress(FileExistsError):
                return path.open("xb"), path
        raise FileExistsError(f"{self._path} and {MAX_NUMBER - 1} files numbered after it exist already")

    def _remember(self, entry: Entry) -> None:
        before = self._latched.pop(entry.topic, None)
        self._latched_bytes -= 0 if before is None else len(before.octets)
        if self._latched_bytes + len(entry.octets) <= MAX_LATCHED_BYTES:
            self._latched[entry.topic] = entry
            self._latched_bytes += len(entry.octets)

    def _repeat_latched(self, now_ns: int) -> None:
        for entry in self._latched.values():
            self._file.add(entry._replace(log_time_ns=now_ns))
