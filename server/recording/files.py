"""MCAP file that is being written: ROS 2 messages as CDR."""

import contextlib
import logging
import os
import re
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.writer import CompressionType, Writer

from protocol import type_descriptions
from protocol.registry import Registry
from server.errors import ConfigurationError

log = logging.getLogger("armbridge.recording")

# Messages that are not yet in a chunk are lost with the process; larger chunks would compress better.
CHUNK_BYTES = 524_288

# A file numbers its channels with 16 bits (MCAP specification, "Channel"); with more the next file begins.
MAX_CHANNELS = 65_535

# No file is ever overwritten; a directory with more recordings of one name is a mistake.
MAX_NUMBER = 100_000

# rosbag2's key in a channel's metadata; its value is YAML, and its reader wants every policy named.
QOS_KEY = "offered_qos_profiles"

_NEVER = "{sec: 9223372036, nsec: 854775807}"
_QOS_PROFILE = """\
- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: {never}
  lifespan: {never}
  liveliness: automatic
  liveliness_lease_duration: {never}
  avoid_ros_namespace_conventions: false
"""

# Releases of rosbag2 before Iron write numbers (rmw_qos_durability_policy_t).
_LATCHED = re.compile(r"\bdurability: *(transient_local|1)\b")


def check_path(path: Path) -> None:
    """Refuse a path at which no recording can begin, by ConfigurationError; a file there is numbered after."""
    try:
        taken = (path.exists() or path.is_symlink()) and not path.is_file()
    except OSError as error:
        raise ConfigurationError(f"recording.file: {path} cannot be used: {error.strerror or error}") from error
    if taken:
        raise ConfigurationError(f"recording.file: {path} must be a regular file or not exist")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise ConfigurationError(f"recording.file: {path} cannot be written: there is no writable folder {path.parent}")


class RecordedMessage(NamedTuple):
    """Message of a file with its times of recording and publication [ns since the epoch], by a steady clock."""

    topic: str
    type_name: str
    latched: bool
    log_time_ns: int
    publish_time_ns: int
    octets: bytes


class RecordingFile:
    """A new file ``NAME.mcap``, or ``NAME_1.mcap`` and so on where that exists; all methods may raise OSError.

    It has the profile ``ros2``, and a channel for each topic and type. With all its channels, the next file begins.
    """

    def __init__(self, path: Path, registry: Registry, limit_bytes: int | None = None) -> None:
        self._wanted_path = path
        self._registry = registry
        self._limit_bytes = limit_bytes
        self._ended_bytes = 0
        self._begin()

    def _begin(self) -> None:
        self._stream, self.path = _open_new(self._wanted_path)
        log.info("recording to %s", self.path)
        self._schemas: dict[str, int] = {}
        # By topic and type: the channel's id and its number of messages.
        self._channels: dict[tuple[str, str], list[int]] = {}
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        try:
            self._writer.start(profile="ros2", library=f"armbridge {metadata.version('armbridge')}")
            # Readers recognize the file from here on, and a full disk has raised its error.
            self._writer.flush()
        except OSError:
            self.abandon()
            raise

    @property
    def full(self) -> bool:
        """True for a recording that has its size, without the chunk that is not complete yet."""
        return self._limit_bytes is not None and self._ended_bytes + self._stream.tell() >= self._limit_bytes

    def add(self, message: RecordedMessage) -> None:
        channel = self._channels.get((message.topic, message.type_name)) or self._new_channel(message)
        channel[1] += 1
        number, count = channel
        self._writer.add_message(number, message.log_time_ns, message.octets, message.publish_time_ns, count)

    def _new_channel(self, message: RecordedMessage) -> list[int]:
        if len(self._channels) >= MAX_CHANNELS:
            self.end()
            self._ended_bytes += self.path.stat().st_size
            self._begin()
        schema = self._schemas.get(message.type_name)
        if schema is None:
            text = type_descriptions.full_text(self._registry, message.type_name)
            schema = self._writer.register_schema(message.type_name, "ros2msg", text.encode())
            self._schemas[message.type_name] = schema
        durability, depth = ("transient_local", 1) if message.latched else ("volatile", 10)
        qos = {QOS_KEY: _QOS_PROFILE.format(durability=durability, depth=depth, never=_NEVER)}
        number = self._writer.register_channel(message.topic, "cdr", schema, qos)
        channel = self._channels[message.topic, message.type_name] = [number, 0]
        return channel

    def flush(self) -> None:
        """End the current chunk, so that it outlives this process."""
        self._writer.flush()

    def end(self) -> None:
        self._writer.finish()
        self._stream.close()

    def abandon(self) -> None:
        """Close the file without its end, after an error."""
        # Buffered data meet the same error again.
        with contextlib.suppress(OSError):
            self._stream.close()


def _open_new(path: Path) -> tuple[BinaryIO, Path]:
    for number in range(MAX_NUMBER):
        numbered = path.with_stem(f"{path.stem}_{number}") if number else path
        with contextlib.suppress(FileExistsError):
            return numbered.open("xb"), numbered
    raise FileExistsError(f"{path} and {MAX_NUMBER - 1} files numbered after it exist already")


def is_latched(metadata: Mapping[str, str]) -> bool:
    """Return True if a channel's metadata say that its topic is latched."""
    return _LATCHED.search(metadata.get(QOS_KEY, "")) is not None
