"""Recordings that are read: MCAP files, also damaged ones, and bags of rosbag2, folders of MCAP or SQLite files.

Files of ROS 2 messages are read also when they were not ended.

rosbag2 (ros2/rosbag2, README.md "Storage format plugin architecture") describes a bag in its ``metadata.yaml``.
"""

import contextlib
import logging
import math
import sqlite3
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import yaml
import zstandard
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from server.errors import RecordingError
from server.recording.files import QOS_KEY, RecordedMessage, is_latched

log = logging.getLogger("armbridge.recording")

# rosbag2's chunks have a megabyte; a larger record than this, also unpacked, is damage, or an image that could not be
# replayed.
MAX_RECORD_BYTES = 268_435_456

MAGIC = b"\x89MCAP0\r\n"  # first bytes of a file (MCAP specification, "Magic")

# Errors that the libraries raise for damaged data.
_DAMAGE = (McapError, OSError, struct.error, ValueError, KeyError, RuntimeError, OverflowError, zstandard.ZstdError)

METADATA_FILE = "metadata.yaml"
SQLITE = ".db3"

_MESSAGES = (
    "SELECT name, type, offered_qos_profiles, timestamp, data FROM messages JOIN topics ON topics.id = topic_id"
    " WHERE serialization_format = 'cdr' ORDER BY timestamp"
)


@dataclass(frozen=True)
class RecordedTopic:
    """Topic of a recording."""

    topic: str
    type_name: str
    latched: bool
    problem: str = ""


@dataclass
class Summary:
    """Contents of a file, which is not complete if it was not ended or is damaged."""

    topics: list[RecordedTopic] = field(default_factory=list)
    messages: int = 0
    duration_s: float = 0.0
    complete: bool = True


class RecordingFile:
    """MCAP file to read; ``damaged`` once it was read up to an early end or octets that are no record."""

    def __init__(self, path: Path) -> None:
        self.damaged = False
        self._path = path

    def summary(self) -> Summary:
        """Return the contents of the file, from its index or, without one, by reading all of it.

        Raises RecordingError for a file that cannot be read, is no MCAP file, or holds no messages of ROS 2.
        """
        summary = self._indexed_summary() or self._counted_summary()
        if all(topic.problem for topic in summary.topics):
            reason = f": {summary.topics[0].topic} {summary.topics[0].problem}" if summary.topics else ""
            raise RecordingError(self._path, f"has no messages of ROS 2{reason}")
        return summary

    def messages(self) -> Iterator[RecordedMessage]:
        """Yield the messages in the order of the file, up to the first damage."""
        for topic, message in self._records():
            if not topic.problem:
                times = message.log_time, message.publish_time
                yield RecordedMessage(topic.topic, topic.type_name, topic.latched, *times, message.data)
        if self.damaged:
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
        topics: dict[RecordedTopic, None] = {}
        messages, earliest_ns, latest_ns = 0, math.inf, -math.inf
        for topic, message in self._records():
            topics[topic] = None
            messages += not topic.problem
            earliest_ns, latest_ns = min(earliest_ns, message.log_time), max(latest_ns, message.log_time)
        return Summary(list(topics), messages, max(latest_ns - earliest_ns, 0.0) / 1e9, complete=not self.damaged)

    def _records(self) -> Iterator[tuple[RecordedTopic, Message]]:
        schemas, topics = dict[int, Schema](), dict[int, RecordedTopic]()
        with self._open() as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise RecordingError(self._path, "is not an MCAP file")
            stream.seek(0)
            try:
                for record in _unpacked(stream):
                    if isinstance(record, Schema):
                        schemas[record.id] = record
                    elif isinstance(record, Channel):
                        topics[record.id] = _recorded_topic(record, schemas.get(record.schema_id))
                    elif isinstance(record, Message):
                        yield topics[record.channel_id], record
            except _DAMAGE:
                self.damaged = True

    def _open(self) -> BinaryIO:
        try:
            return self._path.open("rb")
        except OSError as error:
            raise RecordingError(self._path, f"cannot be read: {error.strerror or error}") from error


def _unpacked(stream: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of a file and of its chunks; raises McapError for a chunk that unpacks to too much."""
    reader = StreamReader(stream, emit_chunks=True, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES)
    for record in reader.records:
        if not isinstance(record, Chunk):
            yield record
            continue
        data = record.data
        if record.compression == "zstd":
            data = zstandard.ZstdDecompressor().stream_reader(data).read(MAX_RECORD_BYTES + 1)
        elif record.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, MAX_RECORD_BYTES + 1)
        if len(data) > MAX_RECORD_BYTES:
            raise McapError(f"a chunk unpacks to more than {MAX_RECORD_BYTES} bytes")
        yield from breakup_chunk(replace(record, compression="", data=data), validate_crc=True)


def _recorded_topic(channel: Channel, schema: Schema | None) -> RecordedTopic:
    problem = ""
    if channel.message_encoding != "cdr":
        problem = f"is encoded as {channel.message_encoding!r}, not 'cdr'"
    elif schema is None:
        problem = "has no schema"
    return RecordedTopic(channel.topic, schema.name if schema else "", is_latched(channel.metadata), problem)


def messages(path: Path) -> Iterator[RecordedMessage]:
    """Yield the messages of a file or bag in their order; raises RecordingError."""
    for file in _files(path) if path.is_dir() else [path]:
        if file.suffix == SQLITE:
            if not file.is_file():
                raise RecordingError(file, "cannot be read: No such file")
            try:
                with contextlib.closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as database:
                    for topic, type_name, qos, log_time_ns, octets in database.execute(_MESSAGES):
                        latched = is_latched({QOS_KEY: str(qos)})
                        yield RecordedMessage(topic, type_name, latched, log_time_ns, log_time_ns, octets)
            except sqlite3.Error as error:
                raise RecordingError(file, f"is no SQLite file of rosbag2: {error}") from error
        else:
            yield from RecordingFile(file).messages()


def _files(bag: Path) -> list[Path]:
    try:
        described: Any = yaml.safe_load((bag / METADATA_FILE).read_text())["rosbag2_bagfile_information"]
        # Early releases name the folder as well.
        files = [bag / Path(name).name for name in described["relative_file_paths"]]
    except FileNotFoundError as error:
        raise RecordingError(bag, f"has no {METADATA_FILE}; ros2 bag reindex writes it") from error
    except (OSError, ValueError, LookupError, TypeError, yaml.YAMLError) as error:
        raise RecordingError(bag, f"{METADATA_FILE} does not describe the files of a bag") from error
    if described.get("compression_mode"):
        raise RecordingError(bag, "is compressed by rosbag2; ros2 bag convert writes it without compression")
    return files
