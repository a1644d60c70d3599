"""Replay of a recording: a reader of MCAP files, a player, and a server without an arm around it.

Files of ROS 2 messages are read also when they were not ended or are damaged.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import math
import sqlite3
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import uvloop
import yaml
import zstandard
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from protocol.codecs import cdr
from protocol.errors import ProtocolError
from robot.logs import LogLimiter
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.errors import GraphError, RecordingError
from server.gateway.listener import Listener
from server.gateway.settings import ServerSettings
from server.graph.topics import Graph
from server.interfaces import load_registry
from server.lifecycle import on_hangup, stop_signals, unless_ended
from server.recording.files import QOS_KEY, RecordedMessage, is_latched
from server.rosapi import RosApi

log = logging.getLogger("armbridge.recording")

# rosbag2's chunks have a megabyte; a larger record than this, also unpacked, is damage, or an image that could not be
# replayed.
MAX_RECORD_BYTES = 268_435_456

MAGIC = b"\x89MCAP0\r\n"  # first bytes of a file (MCAP specification, "Magic")

# Messages that a thread reads for the event loop at once, fewer of raw images.
MESSAGES_AT_A_TIME = 500
BYTES_AT_A_TIME = 16_777_216

# Errors that the libraries raise for damaged data.
_DAMAGE = (McapError, OSError, struct.error, ValueError, KeyError, RuntimeError, OverflowError, zstandard.ZstdError)


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


# Pause between end and beginning; without it a recording of one message would be a flood.
LOOP_PAUSE_S = 0.1


@dataclass(frozen=True)
class ReplayOptions:
    """Options of a replay: seconds of the recording per second, and time for clients to connect before [s]."""

    path: Path
    server: ServerSettings
    access: AccessSettings
    rate: float
    delay_s: float
    loop: bool


def replay(options: ReplayOptions) -> None:
    """Serve a recording to clients until its end, SIGINT or SIGTERM.

    Raises RecordingError for the file, ConfigurationError for certificate and tokens, or none where others could
    connect, and StartError for the port.
    """
    # Ahead of the event loop: a file without an index is read whole, which a signal ends at once here.
    uvloop.run(serve(options, RecordingFile(options.path).summary()))


async def serve(options: ReplayOptions, summary: Summary) -> None:
    """Start a server, play until the end or a signal, stop."""
    graph = Graph(load_registry(options.server.interfaces))
    RosApi(graph)
    # There is no arm to control, so no client needs the lease.
    access = Access(options.access.model_copy(update={"control": "shared"}))
    listener = Listener(graph, options.server, access=access)
    player = RecordingPlayer(graph, RecordingFile(options.path), options.rate)
    ending, _hurry = stop_signals()
    on_hangup(listener.reload_certificate, ending.set)
    try:
        await listener.bind()
        await listener.open()
        # After the listener: recorded topics are not mixed with its own.
        player.advertise(summary.topics)
        incomplete = (
            "" if summary.complete else "; the file was not ended in good order, what can be read of it is played"
        )
        log.info(
            "%s",
            f"armbridge.recordings {options.path}: {listener.url} (rosbridge), "
            f"{len(summary.topics)} topics, {summary.messages} messages, {summary.duration_s:.1f} s{incomplete}",
        )
        await unless_ended(ending, _play(player, options), cancel_timeout_s=None)
    finally:
        await listener.close()
    log.info("replay ended: %d messages published, %d could not be read", player.published, player.unreadable)


async def _play(player: RecordingPlayer, options: ReplayOptions) -> None:
    await asyncio.sleep(options.delay_s)
    await player.play()
    while options.loop:
        await asyncio.sleep(LOOP_PAUSE_S)
        await player.play()


def _next_messages(recorded: Iterator[RecordedMessage]) -> list[RecordedMessage]:
    messages, size_bytes = [], 0
    for message in itertools.islice(recorded, MESSAGES_AT_A_TIME):
        messages.append(message)
        size_bytes += len(message.octets)
        if size_bytes >= BYTES_AT_A_TIME:
            break
    return messages


class RecordingPlayer:
    """Publishes a recording on a graph, with the recorded timing."""

    def __init__(self, graph: Graph, recording: RecordingFile, rate: float = 1.0) -> None:
        self._recording = recording
        self._rate = rate
        self._node = graph.node("replay")
        self._topics: dict[str, RecordedTopic] = {}
        self._unreadable_topics = LogLimiter()
        self.published = 0
        self.unreadable = 0

    def advertise(self, topics: Iterable[RecordedTopic]) -> None:
        """Advertise the recorded topics; a topic that cannot be advertised is logged and left out."""
        for recorded in topics:
            others = self._node.publishers(recorded.topic)
            if any(not other.remote for other in others if other is not self._node):
                log.info("%s is left out: the replaying server has its own", recorded.topic)
            elif problem := recorded.problem or self._advertise(recorded):
                log.warning("%s is left out: it %s", recorded.topic, problem)
            else:
                self._topics.setdefault(recorded.topic, recorded)

    async def play(self) -> None:
        """Publish every message at its time, once through the file."""
        loop = asyncio.get_running_loop()
        started_s, first_ns = loop.time(), None
        recorded = self._recording.messages()
        while messages := await asyncio.to_thread(_next_messages, recorded):
            for message in messages:
                first_ns = message.log_time_ns if first_ns is None else first_ns
                due_s = started_s + (message.log_time_ns - first_ns) / 1e9 / self._rate
                # Also when it is late already: clients are served between two messages.
                await asyncio.sleep(max(0.0, due_s - loop.time()))
                self._publish(message)

    def _advertise(self, recorded: RecordedTopic) -> str:
        """Advertise a topic; return the problem, or an empty text."""
        try:
            self._node.advertise(recorded.topic, recorded.type_name, latch=recorded.latched)
        except GraphError as error:
            return f"cannot be offered: {error}"
        return ""

    def _publish(self, message: RecordedMessage) -> None:
        recorded = self._topics.get(message.topic)
        if recorded is None or recorded.type_name != message.type_name:
            return
        try:
            values = cdr.deserialize(self._node.message_types.registry, message.type_name, message.octets)
            self._node.publish(message.topic, values)
        except (ProtocolError, GraphError) as error:
            self.unreadable += 1
            line = f"{message.topic}: a message of {message.type_name} cannot be read: {error}"
            self._unreadable_topics.write(log, logging.WARNING, line, message.topic)
        else:
            self.published += 1


METADATA_FILE = "metadata.yaml"
SQLITE = ".db3"

_MESSAGES = (
    "SELECT name, type, offered_qos_profiles, timestamp, data FROM messages JOIN topics ON topics.id = topic_id"
    " WHERE serialization_format = 'cdr' ORDER BY timestamp"
)


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
