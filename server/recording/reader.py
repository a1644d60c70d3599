"""Reading of MCAP files of ROS 2 messages, also of files that were not ended or are damaged."""

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
from server.recording.files import RecordedMessage, is_latched

log = logging.getLogger("armbridge.recording")

# rosbag2's chunks have a megabyte; a larger record than this is damage, or an image that could not be replayed.
MAX_RECORD_BYTES = 268_435_456

# Messages outside of chunks are yielded in groups of this size.
MESSAGES_AT_A_TIME = 500

# Errors that the libraries raise for damaged data.
_DAMAGE = (McapError, OSError, struct.error, ValueError, KeyError, RuntimeError, OverflowError, zstandard.ZstdError)


@dataclass(frozen=True)
class RecordedTopic:
    """Topic of a recording.

    Attributes:
        topic: fully qualified name.
        type_name: name of the messages' type.
        latched: True if the topic is latched.
        problem: reason for which it cannot be read; empty if it can.
    """

    topic: str
    type_name: str
    latched: bool
    problem: str = ""


@dataclass
class Summary:
    """Contents of a file.

    Attributes:
        topics: its topics.
        messages: number of its messages.
        duration_s: time from the first message to the last [s].
        complete: False if the file was not ended or is damaged.
    """

    topics: list[RecordedTopic] = field(default_factory=list)
    messages: int = 0
    duration_s: float = 0.0
    complete: bool = True


class Recording:
    """MCAP file to read.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def summary(self) -> Summary:
        """Return the contents of the file, from its index or, without one, by reading all of it.

        Raises:
            RecordingError: the file cannot be read, is no MCAP file, or holds no messages of ROS 2.
        """
        summary = self._indexed_summary() or self._counted_summary()
        if all(topic.problem for topic in summary.topics):
            reason = f": {summary.topics[0].topic} {summary.topics[0].problem}" if summary.topics else ""
            raise RecordingError(self._path, f"has no messages of ROS 2{reason}")
        return summary

    def chunks(self) -> Iterator[list[RecordedMessage]]:
        """Yield the messages in the order of the file, a chunk at a time, up to the first damage.

        Raises:
            RecordingError: the file cannot be read, or is no MCAP file.
        """
        unpacker = _Unpacker(self._path)
        with self._open() as stream:
            yield from unpacker.chunks(stream)
        if unpacker.damaged:
            log.warning("recording %s: what comes after the last readable chunk is left out", self._path)

    def _indexed_summary(self) -> Summary | None:
        with self._open() as stream:
            try:
                index = SeekingReader(stream, record_size_limit=MAX_RECORD_BYTES).get_summary()
            except _DAMAGE:
                return None
        if index is None or index.statistics is None or not index.channels:
            return None
        statistics = index.statistics
        return Summary(
            [_recorded_topic(channel, index.schemas.get(channel.schema_id)) for channel in index.channels.values()],
            statistics.message_count,
            (statistics.message_end_time - statistics.message_start_time) / 1e9,
        )

    def _counted_summary(self) -> Summary:
        unpacker, messages = _Unpacker(self._path), 0
        earliest_ns, latest_ns = math.inf, -math.inf
        with self._open() as stream:
            for message in itertools.chain.from_iterable(unpacker.chunks(stream)):
                messages += 1
                earliest_ns = min(earliest_ns, message.log_time_ns)
                latest_ns = max(latest_ns, message.log_time_ns)
        duration_s = (latest_ns - earliest_ns) / 1e9 if messages else 0.0
        return Summary(list(unpacker.topics.values()), messages, duration_s, complete=not unpacker.damaged)

    def _open(self) -> BinaryIO:
        try:
            return self._path.open("rb")
        except OSError as error:
            raise RecordingError(self._path, f"cannot be read: {error.strerror or error}") from error


class _Unpacker:
    """Unpacks the records of a file into messages.

    Args:
        path: the file, for errors.

    Attributes:
        topics: topics found so far, by channel.
        damaged: True if the file ended before its end, or with octets that are no record.
    """

    def __init__(self, path: Path) -> None:
        self.topics: dict[int, RecordedTopic] = {}
        self.damaged = False
        self._path = path
        self._schemas: dict[int, Schema] = {}

    def chunks(self, stream: BinaryIO) -> Iterator[list[RecordedMessage]]:
        """Yield the messages of each chunk, and those outside of chunks in groups.

        Raises:
            RecordingError: it is no MCAP file.
        """
        outside: list[RecordedMessage] = []
        for record in self._records(stream):
            if isinstance(record, Chunk):
                yield [message for inside in self._unpack(record) for message in self._messages(inside)]
            else:
                outside += self._messages(record)
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

    def _messages(self, record: McapRecord) -> list[RecordedMessage]:
        """Register a schema or channel; return the message of a readable topic, or nothing."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self.topics[record.id] = _recorded_topic(record, self._schemas.get(record.schema_id))
        elif isinstance(record, Message):
            topic = self.topics.get(record.channel_id)
            if topic is not None and not topic.problem:
                times = record.log_time, record.publish_time
                return [RecordedMessage(topic.topic, topic.type_name, topic.latched, *times, record.data)]
        return []


def _recorded_topic(channel: Channel, schema: Schema | None) -> RecordedTopic:
    problem = ""
    if channel.message_encoding != "cdr":
        problem = f"is encoded as {channel.message_encoding!r}, not 'cdr'"
    elif schema is None:
        problem = "has no schema"
    return RecordedTopic(channel.topic, schema.name if schema else "", is_latched(channel.metadata), problem)
