"""CBOR frames (RFC 8949) of rosbridge's ``cbor`` and ``cbor-raw`` compression; they only go out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cbor2

# A map of three pairs: op, topic and msg, of which the first never changes.
_PUBLISH_HEAD = b"\xa3" + cbor2.dumps("op") + cbor2.dumps("publish") + cbor2.dumps("topic")
_MSG_KEY = cbor2.dumps("msg")


def encode(msg: Mapping[str, Any]) -> bytes:
    """Encode a message.

    Args:
        msg: dicts, lists, text, numbers, booleans, bytes, and typed arrays as `protocol.codecs.arrays` makes them.
    """
    return cbor2.dumps(msg)


def publish(topic: str, encoded_msg: bytes) -> bytes:
    """Return the frame that publishes a message.

    Args:
        topic: the topic as the subscriber spells it.
        encoded_msg: the message as `encode` returns it.
    """
    return b"".join((_PUBLISH_HEAD, cbor2.dumps(topic), _MSG_KEY, encoded_msg))
