from __future__ import annotations

import asyncio
import gzip
import os
import threading
from pathlib import Path

import pytest

from server.gateway import file_cache
from server.gateway.file_cache import FileCache, StoredFile

LONG = b"0123456789" * 1000


def test_a_form_is_known_by_its_content() -> None:
    plain, packed = (StoredFile.of(LONG, gzipped=gzipped) for gzipped in (False, True))
    assert (plain.octets, gzip.decompress(packed.octets)) == (LONG, LONG)
    assert packed == StoredFile.of(LONG, gzipped=True)
    assert len({plain.etag, packed.etag, StoredFile.of(LONG[:-1], gzipped=False).etag}) == 3


@pytest.mark.parametrize("octets", [b"short", os.urandom(5000)])
def test_what_gzip_makes_no_smaller_stays_as_it_is(octets: bytes) -> None:
    assert StoredFile.of(octets, gzipped=True) == StoredFile.of(octets, gzipped=False)


async def test_a_file_is_read_once_until_it_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    path.write_bytes(LONG)
    cache, reads = FileCache(), []
    read_bytes = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda self: reads.append(self) or read_bytes(self))
    first = await cache.read(lambda: path, gzipped=True)
    assert await cache.read(lambda: path, gzipped=True) is first
    assert len(reads) == 1
    path.write_bytes(LONG + b".")
    assert (await cache.read(lambda: path, gzipped=False)).octets == LONG + b"."


async def test_the_file_that_was_asked_for_the_longest_ago_goes_first(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in "abc"]
    for path in paths:
        path.write_bytes(LONG)
    a, b, c = paths
    cache = FileCache(2 * len(LONG))
    kept = {path: await cache.read(lambda path=path: path, gzipped=False) for path in (a, b)}  # type: ignore[misc]
    assert await cache.read(lambda: a, gzipped=False) is kept[a]
    await cache.read(lambda: c, gzipped=False)
    assert await cache.read(lambda: a, gzipped=False) is kept[a]
    assert await cache.read(lambda: b, gzipped=False) is not kept[b]


async def test_a_file_larger_than_all_that_is_kept_is_read_and_not_kept(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(LONG)
    cache = FileCache(len(LONG) - 1)
    first = await cache.read(lambda: path, gzipped=False)
    assert first.octets == LONG
    assert await cache.read(lambda: path, gzipped=False) is not first


async def test_who_finds_and_reads_is_not_the_event_loop_and_one_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(LONG)
    at_work: list[int] = []

    def find() -> Path:
        assert threading.current_thread() is not threading.main_thread()
        at_work.append(1)
        assert len(at_work) == 1
        at_work.pop()
        return path

    cache = FileCache()
    await asyncio.gather(*(cache.read(find, gzipped=True) for _ in range(5)))


async def test_what_cannot_be_found_is_told_to_whoever_asks(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        await FileCache().read(lambda: tmp_path / "none", gzipped=False)


def test_all_meshes_of_an_arm_fit_into_what_is_kept() -> None:
    meshes_of_the_so101_bytes = 16_100_000
    assert 2 * meshes_of_the_so101_bytes < file_cache.LIMIT_BYTES
