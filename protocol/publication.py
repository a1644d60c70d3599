"""One published message on its way out: encoded once for all subscribers that ask for the same encoding.

Encoded messages are what a connection sends or drops as a whole: one frame, or the fragments of a long one.
"""

from __future__ import annotations

import functools
import math
import struct
import uuid
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple, TypeAlias

from protocol.codecs import bson, cbor, cdr, json, png, ros1_serialization
from protocol.codecs.pieces import encoding_cost_bytes
from protocol.dialect import Dialect, to_ros1
from protocol.framing import split
from protocol.limits import MAX_PIECES
from protocol.messages import Stamp
from protocol.registry import Registry

# What the interpreter spends on a waiting frame beside its bytes (470 were measured, the rest is the allocator's),
# so that a flood of tiny frames is bounded too.
FRAME_OVERHEAD_BYTES = 512

# First byte of a WebSocket frame: the last of its message (0x80), text or binary (RFC 6455, 5.2).
_TEXT, _BINARY = 0x81, 0x82

# In place of a length from 0 to 125: the length follows in two bytes, or in eight (RFC 6455, 5.2).
_TWO_BYTE_LENGTH, _EIGHT_BYTE_LENGTH = 126, 127
_HEADER_BYTES = {_TWO_BYTE_LENGTH: 4, _EIGHT_BYTE_LENGTH: 10}


# Messages of this size on are encoded by a thread. The slowest encodings, those in Python, take 1 ms for 10 kB.
LARGE_BYTES = 65_536


class Frame(NamedTuple):
    """One WebSocket message; the data of a text frame is ASCII."""

    data: bytes
    text: bool


def _header(opening: int, length: int) -> bytes:
    """Return what goes before the data of a WebSocket frame (RFC 6455, 5.2), as a server sends it, not masked."""
    if length < _TWO_BYTE_LENGTH:
        return bytes((opening, length))
    if length < 1 << 16:
        return struct.pack("!BBH", opening, _TWO_BYTE_LENGTH, length)
    return struct.pack("!BBQ", opening, _EIGHT_BYTE_LENGTH, length)


class EncodedMessage:
    """Frames that are sent or dropped as a whole: one, or the fragments of one.

    Attributes:
        wire: the WebSocket frames for all clients that they are sent to, in pieces that leave together: one piece for
            each of several frames, one or several for a single frame.
        frame_count: number of frames; 0 for a message that is still to be encoded, or cannot be.
        ready: False while the message is still to be encoded.
        size_bytes: size with what the interpreter spends on it, an estimate until the message is ready.
    """

    __slots__ = ("_encode", "frame_count", "ready", "size_bytes", "wire")

    def __init__(self, *frames: Frame) -> None:
        self.wire = tuple([_header(_TEXT if text else _BINARY, len(data)) + data for data, text in frames])
        self.frame_count = len(frames)
        self.ready = True
        self.size_bytes = sum([len(frame.data) + FRAME_OVERHEAD_BYTES for frame in frames])
        self._encode: Callable[[], EncodedMessage] | None = None

    @classmethod
    def text(cls, *parts: bytes) -> EncodedMessage:
        """Return a message of one text frame; the parts of a large one are not copied."""
        length = sum(map(len, parts))
        pieces = (_header(_TEXT, length), *parts)
        encoded = cls()
        encoded.wire = pieces if length >= LARGE_BYTES else (b"".join(pieces),)
        encoded.frame_count = 1
        encoded.size_bytes = length + FRAME_OVERHEAD_BYTES
        return encoded

    @classmethod
    def later(cls, encode: Callable[[], EncodedMessage], size_bytes: int) -> EncodedMessage:
        """Return a message that :meth:`encode` is still to encode."""
        encoded = cls()
        encoded.ready = False
        encoded.size_bytes = size_bytes
        encoded._encode = encode
        return encoded

    def encode(self) -> None:
        """Encode a message of :meth:`later`, in any thread; on ProtocolError it is ready without frames."""
        if self._encode is None:
            return
        try:
            encoded = self._encode()
            self.wire, self.size_bytes, self.frame_count = encoded.wire, encoded.size_bytes, encoded.frame_count
        finally:
            self._encode = None
            self.ready = True

    @property
    def frames(self) -> tuple[Frame, ...]:
        wire = (b"".join(self.wire),) if self.frame_count == 1 else self.wire
        return tuple(Frame(each[_HEADER_BYTES.get(each[1], 2) :], text=each[0] == _TEXT) for each in wire)


def pack(frame: Frame, fragment_size: int | None, fragment_id: str) -> EncodedMessage:
    """Cut a text frame beyond ``fragment_size`` [characters] into at most `MAX_PIECES` fragments."""
    length = len(frame.data)
    if fragment_size is None or length <= fragment_size or not frame.text:
        return EncodedMessage(frame)
    size = max(fragment_size, math.ceil(length / MAX_PIECES))
    return EncodedMessage(*(Frame(piece, text=True) for piece in split(frame.data.decode("ascii"), size, fragment_id)))


# What a subscription may ask for as its compression, and BSON for clients that speak it.
Encoding: TypeAlias = Literal["none", "png", "cbor", "cbor-raw", "bson"]

# Spelled topic, encoding, dialect and greatest length of a frame.
_Key: TypeAlias = tuple[str, Encoding, Dialect, int | None]


class PublishedMessage:
    """A complete message of a topic, and the frames made of it.

    Args:
        msg: the message as `protocol.messages.complete` returns it, which nobody changes any more, or its JSON.
        cost_bytes: cost of its encoding, as an amount of JSON [bytes]; None to find out.
        light: True for a message that is encoded as JSON quickly, however large it is.
    """

    __slots__ = (
        "_by_key",
        "_cost_bytes",
        "_encoded",
        "_light",
        "_msg",
        "_registry",
        "publisher",
        "received",
        "sequence_number",
        "topic",
        "type_name",
    )

    def __init__(
        self,
        topic: str,
        type_name: str,
        msg: Mapping[str, Any] | bytes,
        registry: Registry,
        received: Stamp,
        publisher: object = None,
        cost_bytes: int | None = None,
        *,
        light: bool = False,
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.publisher = publisher
        self.sequence_number = 0
        self._registry = registry
        self._cost_bytes = cost_bytes
        self._light = light
        self.received = received
        # Subscribers spell a topic with or without its leading slash: two spellings of each encoding and dialect.
        self._by_key: dict[_Key, EncodedMessage] = {}
        # The message alone, the costly part, which frames of all spellings share.
        self._encoded: dict[tuple[Encoding, Dialect], bytes] = {}
        self._msg: Mapping[str, Any] | None = None
        if isinstance(msg, bytes):
            self._encoded["none", "ros2"] = msg
            self._cost_bytes = len(msg)
        else:
            self._msg = msg

    @property
    def msg(self) -> Mapping[str, Any]:
        """The message; JSON is decoded when it is first asked for."""
        if self._msg is None:
            decoded: Any = json.decode(self._encoded["none", "ros2"])
            self._msg = decoded
        return self._msg

    @property
    def size_bytes(self) -> int:
        """Size of the message as it was encoded for subscribers; as JSON while it has none [bytes]."""
        if self.large:
            return self.cost_bytes
        if not self._encoded:
            self._encoded["none", "ros2"] = self._encode("none", "ros2")
        return max(map(len, self._encoded.values()))

    @property
    def cost_bytes(self) -> int:
        """Cost of encoding the message, as an amount of JSON, up to `LARGE_BYTES` where nobody has said it [bytes]."""
        if self._cost_bytes is None:
            self._cost_bytes = encoding_cost_bytes(self.msg, LARGE_BYTES)
        return self._cost_bytes

    @property
    def large(self) -> bool:
        """True for a message that is encoded later, by a thread: others would wait too long meanwhile."""
        return self.cost_bytes >= LARGE_BYTES

    def encoded(
        self, spelled_topic: str, encoding: Encoding, dialect: Dialect, fragment_size: int | None
    ) -> EncodedMessage:
        """Return the frame for subscribers that ask alike, or its fragments; a large message is still to be encoded.

        A message of an unknown type goes out as it came, and as ``cbor`` instead of ``cbor-raw``.
        """
        key = spelled_topic, encoding, dialect, fragment_size
        encoded = self._by_key.get(key)
        if encoded is None:
            at_once = self._light and encoding == "none" and dialect == "ros2" and fragment_size is None
            if self.large and not at_once:
                encoded = EncodedMessage.later(functools.partial(self._pack, key), self.cost_bytes)
            else:
                encoded = self._pack(key)
            self._by_key[key] = encoded
        return encoded

    def _pack(self, key: _Key) -> EncodedMessage:
        spelled_topic, encoding, dialect, fragment_size = key
        if fragment_size is None and encoding == "none":
            return EncodedMessage.text(*self._parts(spelled_topic, dialect))
        if fragment_size is None:
            return EncodedMessage(self._frame(spelled_topic, encoding, dialect))
        # All clients get the fragments under this id, which no other frame has.
        return pack(self._frame(spelled_topic, encoding, dialect), fragment_size, uuid.uuid4().hex)

    def _frame(self, spelled_topic: str, encoding: Encoding, dialect: Dialect) -> Frame:
        if encoding == "png":
            picture = png.encode(self._frame(spelled_topic, "none", dialect).data)
            return Frame(json.encode({"op": "png", "data": picture}), text=True)
        if encoding == "none":
            return Frame(b"".join(self._parts(spelled_topic, dialect)), text=True)
        codec = bson if encoding == "bson" else cbor
        return Frame(codec.publish(spelled_topic, self._encoded_msg(encoding, dialect)), text=False)

    def _parts(self, spelled_topic: str, dialect: Dialect) -> tuple[bytes, bytes, bytes]:
        """Return the text frame in pieces, which are put together in one go: a message may have megabytes."""
        # rosbridge sends exactly these three keys; behind them goes the message as it was encoded.
        opening = b'{"op":"publish","topic":%b,"msg":' % json.encode(spelled_topic)
        return opening, self._encoded_msg("none", dialect), b"}"

    def _encoded_msg(self, encoding: Encoding, dialect: Dialect) -> bytes:
        encoded_msg = self._encoded.get((encoding, dialect))
        if encoded_msg is None:
            encoded_msg = self._encoded[encoding, dialect] = self._encode(encoding, dialect)
        return encoded_msg

    def _encode(self, encoding: Encoding, dialect: Dialect) -> bytes:
        if encoding == "none" and dialect == "ros2":
            # How the server keeps a message is how most clients want it.
            return self._encode_json(self.msg)
        known = self._registry.knows(self.type_name)
        if encoding == "cbor-raw" and known:
            if dialect == "ros1":
                octets = ros1_serialization.serialize(self._registry, self.type_name, self.msg, self.sequence_number)
            else:
                octets = cdr.serialize(self._registry, self.type_name, self.msg)
            return cbor.encode({"secs": self.received.sec, "nsecs": self.received.nanosec, "bytes": octets})
        msg = self.msg
        if known and encoding != "none":
            msg = cbor.packed(self._registry, self.type_name, msg, numbers=encoding != "bson")
        if known and dialect == "ros1":
            msg = to_ros1(self._registry, self.type_name, msg, self.sequence_number)
        return {"none": self._encode_json, "bson": bson.encode}.get(encoding, cbor.encode)(msg)

    def _encode_json(self, msg: Mapping[str, Any]) -> bytes:
        return json.encode_in_pieces(msg) if self.large and not self._light else json.encode(msg)
