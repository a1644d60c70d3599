"""Recordings that are read: MCAP files, also damaged ones, and bags of rosbag2, folders of MCAP or SQLite files.

Files of ROS 2 messages are read also when they were not ended.

rosbag2 (ros2/rosbag2, README.md "Storage format plugin architecture") describes a bag in its ``metadata.yaml``.
"""

import contextlib
import logging
import sqlite3
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import yaml
import zstandard
from mcap.exceptions import McapError
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


def messages(path: Path) -> Iterator[RecordedMessage]:
    """Yield the messages of ROS 2 of a file or bag in their order, up to the first damage; raises RecordingError."""
    for file in _files(path) if path.is_dir() else [path]:
        yield from _of_sqlite(file) if file.suffix == SQLITE else _of_mcap(file)


def _of_sqlite(file: Path) -> Iterator[RecordedMessage]:
    if not file.is_file():
        raise RecordingError(file, "cannot be read: No such file")
    try:
        with contextlib.closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as database:
            for topic, type_name, qos, log_time_ns, octets in database.execute(_MESSAGES):
                latched = is_latched({QOS_KEY: str(qos)})
                yield RecordedMessage(topic, type_name, latched, log_time_ns, log_time_ns, octets)
    except sqlite3.Error as error:
        raise RecordingError(file, f"is no SQLite file of rosbag2: {error}") from error


def _of_mcap(file: Path) -> Iterator[RecordedMessage]:
    schemas = dict[int, Schema]()
    # Topic, type, and True for a latched one, by channel; None for a topic that is left out.
    topics: dict[int, tuple[str, str, bool] | None] = {}
    with _opened(file) as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise RecordingError(file, "is not an MCAP file")
        stream.seek(0)
        try:
            for record in _unpacked(stream):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel) and record.id not in topics:
                    topics[record.id] = _topic_of(file, record, schemas.get(record.schema_id))
                elif isinstance(record, Message) and (topic := topics[record.channel_id]) is not None:
                    yield RecordedMessage(*topic, record.log_time, record.publish_time, record.data)
        except _DAMAGE:
            log.warning("recording %s: what comes after the last readable chunk is left out", file)


def _opened(file: Path) -> BinaryIO:
    try:
        return file.open("rb")
    except OSError as error:
        raise RecordingError(file, f"cannot be read: {error.strerror or error}") from error


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


def _topic_of(file: Path, channel: Channel, schema: Schema | None) -> tuple[str, str, bool] | None:
    if channel.message_encoding == "cdr" and schema is not None:
        return channel.topic, schema.name, is_latched(channel.metadata)
    encoding = channel.message_encoding
    problem = "has no schema" if encoding == "cdr" else f"is encoded as {encoding!r}, not 'cdr'"
    log.warning("recording %s: %s is left out: it %s", file, channel.topic, problem)
    return None


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
