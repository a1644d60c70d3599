"""One message on its way out, encoded once for all subscribers that want it alike."""

from __future__ import annotations

import functools
import uuid
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

from protocol.codecs import arrays, bson, cbor, cdr, json, png
from protocol.dialect import Dialect, to_ros1
from protocol.messages import Stamp
from protocol.parcel import Frame, Parcel, pack
from protocol.registry import Registry

# What a subscription may ask for as its compression, and BSON for clients that speak it.
Encoding: TypeAlias = Literal["none", "png", "cbor", "cbor-raw", "bson"]

# Topic as it is spelled, encoding, dialect and greatest length of a frame.
_Key: TypeAlias = tuple[str, Encoding, Dialect, int | None]

# The topics of a large robot, each in two spellings.
_MAX_OPENINGS = 1024


class Publication:
    """A complete message of a topic, and the frames made of it.

    Args:
        topic: fully qualified name of the topic.
        type_name: canonical name of the message's type.
        msg: the message as `protocol.messages.complete` returns it, or as it came where the registry does not know
            its type; not to be changed from here on.
        registry: where the type is looked up.
        received: when the message came.
        publisher: who published it, for those whom it concerns.
    """

    __slots__ = ("_encoded", "_parcels", "_registry", "msg", "publisher", "received", "topic", "type_name")

    def __init__(
        self,
        topic: str,
        type_name: str,
        msg: Mapping[str, Any],
        registry: Registry,
        received: Stamp,
        publisher: object = None,
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.msg = msg
        self.publisher = publisher
        self._registry = registry
        self.received = received
        # Subscribers spell a topic with or without its leading slash: two spellings of each encoding and dialect.
        self._parcels: dict[_Key, Parcel] = {}
        # The message alone, the costly part, which frames of all spellings share.
        self._encoded: dict[tuple[Encoding, Dialect], bytes] = {}

    @property
    def size_bytes(self) -> int:
        """How large the message is as subscribers got it; as JSON, where nobody has got it yet."""
        if not self._encoded:
            self._encoded["none", "ros2"] = self._encode("none", "ros2")
        return max(map(len, self._encoded.values()))

    def frame(self, spelled_topic: str, encoding: Encoding = "none", dialect: Dialect = "ros2") -> Frame:
        """Return the frame for subscribers that spell the topic like this and want this encoding and dialect.

        A message of a type that the registry does not know goes out as it came, and as ``cbor`` instead of
        ``cbor-raw``.
        """
        return self.parcel(spelled_topic, encoding, dialect, None).frames[0]

    def parcel(self, spelled_topic: str, encoding: Encoding, dialect: Dialect, fragment_size: int | None) -> Parcel:
        """Return the frame, or its fragments where it is longer than ``fragment_size`` [characters].

        The other arguments are those of :meth:`frame`.
        """
        key = spelled_topic, encoding, dialect, fragment_size
        parcel = self._parcels.get(key)
        if parcel is None:
            parcel = self._parcels[key] = self._pack(key)
        return parcel

    def _pack(self, key: _Key) -> Parcel:
        spelled_topic, encoding, dialect, fragment_size = key
        if fragment_size is None:
            return Parcel(self._frame(spelled_topic, encoding, dialect))
        # All clients get the fragments under this id, which no other frame has.
        return pack(self.frame(spelled_topic, encoding, dialect), fragment_size, uuid.uuid4().hex)

    def _frame(self, spelled_topic: str, encoding: Encoding, dialect: Dialect) -> Frame:
        if encoding == "png":
            picture = png.encode(self.frame(spelled_topic, "none", dialect).data)
            return Frame(json.encode({"op": "png", "data": picture}), text=True)
        encoded_msg = self._encoded.get((encoding, dialect))
        if encoded_msg is None:
            encoded_msg = self._encoded[encoding, dialect] = self._encode(encoding, dialect)
        if encoding == "none":
            # Joined in one go: a message may have megabytes.
            return Frame(b"".join((_opening(spelled_topic), encoded_msg, b"}")), text=True)
        codec = bson if encoding == "bson" else cbor
        return Frame(codec.publish(spelled_topic, encoded_msg), text=False)

    def _encode(self, encoding: Encoding, dialect: Dialect) -> bytes:
        if encoding == "none" and dialect == "ros2":
            # How the server keeps a message is how most clients want it.
            return json.encode(self.msg)
        known = self._registry.knows(self.type_name)
        if encoding == "cbor-raw" and known:
            # Serialized messages are the same in both dialects.
            octets = cdr.serialize(self._registry, self.type_name, self.msg)
            return cbor.encode({"secs": self.received.sec, "nsecs": self.received.nanosec, "bytes": octets})
        msg = self._packed(encoding) if known else self.msg
        if known and dialect == "ros1":
            msg = to_ros1(self._registry, self.type_name, msg)
        return {"none": json.encode, "bson": bson.encode}.get(encoding, cbor.encode)(msg)

    def _packed(self, encoding: Encoding) -> Mapping[str, Any]:
        if encoding == "none":
            return self.msg
        pack = arrays.with_octets if encoding == "bson" else arrays.with_typed_arrays
        return pack(self._registry, self.type_name, self.msg)


@functools.lru_cache(maxsize=_MAX_OPENINGS)
def _opening(spelled_topic: str) -> bytes:
    # rosbridge sends exactly these three keys; behind them goes the message as it was encoded.
    return b'{"op":"publish","topic":%b,"msg":' % json.encode(spelled_topic)
