"""Reads an MCAP file of ROS 2 messages from its beginning, as far as it goes: also one that was never ended."""

from __future__ import annotations

import itertools
import logging
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from server.errors import RecordingError
from server.recording.mcap_file import Entry
from server.recording.qos import is_latched

log = logging.getLogger("armbridge.recording")

# rosbag2's chunks have a megabyte; a record of more than this is damage, or a picture nobody could replay.
MAX_RECORD_BYTES = 268_435_456

# Messages that stand outside of chunks are handed on in groups.
MESSAGES_AT_A_TIME = 500

# What the libraries say of octets that are not what they should be.
_DAMAGE = (McapError, OSError, struct.error, ValueError, KeyError, RuntimeError, OverflowError, zstandard.ZstdError)


@dataclass(frozen=True)
class Track:
    """What was recorded of one topic.

    Attributes:
        topic: fully qualified name.
        type_name: name of the messages' type.
        latched: whether the topic is latched.
        problem: why it cannot be read; empty when it can.
    """

    topic: str
    type_name: str
    latched: bool
    problem: str = ""


@dataclass
class Outline:
    """What a file holds.

    Attributes:
        tracks: its topics.
        messages: how many messages there are.
        duration_s: from the first message to the last [s].
        whole: whether the file was ended in good order.
    """

    tracks: list[Track] = field(default_factory=list)
    messages: int = 0
    duration_s: float = 0.0
    whole: bool = True


class Recording:
    """A file that can be read.

    Args:
        path: where it is.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def outline(self) -> Outline:
        """Tell what is in the file: by its index, or by reading all of it where there is none.

        Raises:
            RecordingError: the file cannot be read, is no MCAP file, or holds no messages of ROS 2.
        """
        outline = self._by_index() or self._by_reading()
        if all(track.problem for track in outline.tracks):
            reason = f": {outline.tracks[0].topic} {outline.tracks[0].problem}" if outline.tracks else ""
            raise RecordingError(self._path, f"has no messages of ROS 2{reason}")
        return outline

    def entries(self) -> Iterator[list[Entry]]:
        """Go through the messages in the order of the file, a chunk at a time; damage ends them.

        Raises:
            RecordingError: the file cannot be read, or is no MCAP file.
        """
        unpacking = _Unpacking(self._path)
        with self._open() as stream:
            yield from unpacking.entries(stream)
        if unpacking.damaged:
            log.warning("recording %s: what comes after the last readable chunk is left out", self._path)

    def _by_index(self) -> Outline | None:
        with self._open() as stream:
            try:
                summary = SeekingReader(stream, record_size_limit=MAX_RECORD_BYTES).get_summary()
            except _DAMAGE:
                return None
        if summary is None or summary.statistics is None or not summary.channels:
            return None
        counted = summary.statistics
        return Outline(
            [_track(channel, summary.schemas.get(channel.schema_id)) for channel in summary.channels.values()],
            counted.message_count,
            (counted.message_end_time - counted.message_start_time) / 1e9,
        )

    def _by_reading(self) -> Outline:
        unpacking, messages = _Unpacking(self._path), 0
        earliest_ns, latest_ns = math.inf, -math.inf
        with self._open() as stream:
            for entry in itertools.chain.from_iterable(unpacking.entries(stream)):
                messages += 1
                earliest_ns = min(earliest_ns, entry.log_time_ns)
                latest_ns = max(latest_ns, entry.log_time_ns)
        duration_s = (latest_ns - earliest_ns) / 1e9 if messages else 0.0
        return Outline(list(unpacking.tracks.values()), messages, duration_s, whole=not unpacking.damaged)

    def _open(self) -> BinaryIO:
        try:
            return self._path.open("rb")
        except OSError as error:
            raise RecordingError(self._path, f"cannot be read: {error.strerror or error}") from error


class _Unpacking:
    """Makes entries of records.

    Args:
        path: the file, for errors.

    Attributes:
        tracks: what is known of topics so far, by channel.
        damaged: whether the file ended before its end, or with octets that are no record.
    """

    def __init__(self, path: Path) -> None:
        self.tracks: dict[int, Track] = {}
        self.damaged = False
        self._path = path
        self._schemas: dict[int, Schema] = {}

    def entries(self, stream: BinaryIO) -> Iterator[list[Entry]]:
        """Yield the messages of each chunk, and those outside of chunks in groups.

        Raises:
            RecordingError: it is no MCAP file.
        """
        outside: list[Entry] = []
        for record in self._records(stream):
            if isinstance(record, Chunk):
                yield [entry for inside in self._unpack(record) for entry in self._entry(inside)]
            else:
                outside += self._entry(record)
            if self.damaged:
                break
            if len(outside) >= MESSAGES_AT_A_TIME:
                yield outside
                outside = []
        yield outside

    def _records(self, stream: BinaryIO) -> Iterator[McapRecord]:
        started = False
        try:
            for record in StreamReader(stream, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES).records:
                started = True
                yield record
        except _DAMAGE as error:
            if not started:
                raise RecordingError(self._path, "is not an MCAP file") from error
            self.damaged = True

    def _unpack(self, chunk: Chunk) -> list[McapRecord]:
        try:
            if chunk.uncompressed_size <= MAX_RECORD_BYTES:
                return breakup_chunk(chunk, validate_crc=True)
        except _DAMAGE:
            log.debug("recording %s: a damaged chunk", self._path, exc_info=True)
        self.damaged = True
        return []

    def _entry(self, record: McapRecord) -> list[Entry]:
        """Note what a record tells of topics; a message of a topic that can be read becomes one entry."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self.tracks[record.id] = _track(record, self._schemas.get(record.schema_id))
        elif isinstance(record, Message):
            track = self.tracks.get(record.channel_id)
            if track is not None and not track.problem:
                times = record.log_time, record.publish_time
                return [Entry(track.topic, track.type_name, track.latched, *times, record.data)]
        return []


def _track(channel: Channel, schema: Schema | None) -> Track:
    problem = ""
    if channel.message_encoding != "cdr":
        problem = f"is encoded as {channel.message_encoding!r}, not 'cdr'"
    elif schema is None:
        problem = "has no schema"
    return Track(channel.topic, schema.name if schema else "", is_latched(channel.metadata), problem)
