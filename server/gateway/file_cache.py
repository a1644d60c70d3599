"""Files as they are sent: read, compressed and named by their content once, and kept while they do not change."""

from __future__ import annotations

import asyncio
import gzip
import hashlib
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

# The page has one megabyte, an arm's meshes at their full size have 16, and less again when both forms are asked for.
LIMIT_BYTES = 64 << 20

# Below this the header alone outweighs what is won.
MIN_GZIP_BYTES = 1000

# Twice the time of the lowest level for a tenth less; more gains nothing on scripts and meshes.
GZIP_LEVEL = 6

# 96 bits tell all files ever served apart.
ETAG_DIGITS = 24


@dataclass(frozen=True, slots=True)
class StoredFile:
    """A file in one of its two forms.

    Attributes:
        octets: what is sent.
        etag: name of the content in this form.
        gzipped: whether the octets are compressed.
    """

    octets: bytes
    etag: str
    gzipped: bool

    @classmethod
    def of(cls, octets: bytes, *, gzipped: bool) -> StoredFile:
        """Bring content into the form that is asked for, if that makes it smaller."""
        digits = hashlib.sha256(octets).hexdigest()[:ETAG_DIGITS]
        if gzipped and len(octets) >= MIN_GZIP_BYTES:
            smaller = gzip.compress(octets, GZIP_LEVEL, mtime=0)
            if len(smaller) < len(octets):
                return cls(smaller, f'"{digits}-gzip"', gzipped=True)
        return cls(octets, f'"{digits}"', gzipped=False)


# What a file was when it was read: a change of any of these is a change of the file.
_Key = tuple[Path, int, int, bool]


class FileCache:
    """Reads files on a thread, one at a time, so that neither a slow disk nor a large file holds the server up.

    Args:
        limit_bytes: what is kept; the file that was asked for the longest ago goes first.
    """

    def __init__(self, limit_bytes: int = LIMIT_BYTES) -> None:
        self._limit_bytes = limit_bytes
        self._kept: OrderedDict[_Key, StoredFile] = OrderedDict()
        self._kept_bytes = 0
        self._one_at_a_time = asyncio.Lock()

    async def read(self, find: Callable[[], Path], *, gzipped: bool) -> StoredFile:
        """Read a file, or take it from what is kept.

        Args:
            find: says where the file is; called on the thread, may raise.
            gzipped: whether its reader takes gzip.

        Raises:
            OSError: it cannot be read.
        """
        async with self._one_at_a_time:
            return await asyncio.to_thread(self._read, find, gzipped)

    def _read(self, find: Callable[[], Path], gzipped: bool) -> StoredFile:
        path = find()
        state = path.stat()
        key = (path, state.st_mtime_ns, state.st_size, gzipped)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        file = StoredFile.of(path.read_bytes(), gzipped=gzipped)
        self._keep(key, file)
        return file

    def _keep(self, key: _Key, file: StoredFile) -> None:
        self._kept[key] = file
        self._kept_bytes += len(file.octets)
        while self._kept_bytes > self._limit_bytes:
            _, dropped = self._kept.popitem(last=False)
            self._kept_bytes -= len(dropped.octets)
