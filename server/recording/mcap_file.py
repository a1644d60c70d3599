"""One MCAP file that is being written: ROS 2 messages as CDR, a channel for each topic and type."""

from __future__ import annotations

from importlib import metadata
from typing import BinaryIO, NamedTuple

from mcap.writer import CompressionType, Writer

from protocol import interface_text
from protocol.registry import Registry
from server.recording.qos import channel_metadata

# What is not yet in a chunk is lost with the process; larger ones would shrink better.
CHUNK_BYTES = 524_288

# Where our own facts stand among a file's metadata.
FACTS = "armbridge"


class Entry(NamedTuple):
    """A message as it stands in a file.

    Attributes:
        topic: fully qualified name.
        type_name: canonical name of the message's type.
        latched: whether the topic is latched.
        log_time_ns: when it was recorded [ns since the epoch], by a clock that never jumps.
        publish_time_ns: when it was published [ns since the epoch].
        octets: the message as CDR.
    """

    topic: str
    type_name: str
    latched: bool
    log_time_ns: int
    publish_time_ns: int
    octets: bytes


class McapFile:
    """A file with the profile ``ros2``; everything here may raise OSError.

    Args:
        stream: where it goes; closed by :meth:`end`.
        registry: types.
        facts: what else the file is to tell.
    """

    def __init__(self, stream: BinaryIO, registry: Registry, facts: dict[str, str]) -> None:
        self._stream = stream
        self._registry = registry
        self._writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._schemas: dict[str, int] = {}
        # By topic and type: the channel, and how many messages it has.
        self._channels: dict[tuple[str, str], list[int]] = {}
        version = metadata.version("armbridge")
        self._writer.start(profile="ros2", library=f"armbridge {version}")
        self._writer.add_metadata(FACTS, {"version": version, **facts})
        # From here on it is a file that readers know, and a full disk has shown itself.
        self._writer.flush()

    @property
    def size_bytes(self) -> int:
        """How large the file is, without the chunk in the making."""
        return self._stream.tell()

    def add(self, entry: Entry) -> None:
        """Append a message."""
        channel = self._channels.get((entry.topic, entry.type_name))
        if channel is None:
            channel = self._channels[entry.topic, entry.type_name] = [self._register(entry), 0]
        channel[1] += 1
        self._writer.add_message(channel[0], entry.log_time_ns, entry.octets, entry.publish_time_ns, channel[1])

    def flush(self) -> None:
        """End the chunk in the making, so that it outlives this process."""
        self._writer.flush()

    def end(self, facts: dict[str, str]) -> None:
        """Write the index, and close.

        Args:
            facts: what is known only now.
        """
        self._writer.flush()
        if facts:
            self._writer.add_metadata(FACTS, facts)
        self._writer.finish()
        self._stream.close()

    def _register(self, entry: Entry) -> int:
        schema = self._schemas.get(entry.type_name)
        if schema is None:
            text = interface_text.full_text(self._registry, entry.type_name)
            schema = self._writer.register_schema(entry.type_name, "ros2msg", text.encode())
            self._schemas[entry.type_name] = schema
        return self._writer.register_channel(entry.topic, "cdr", schema, channel_metadata(entry.latched))
