"""One message on its way out, encoded once for all of its subscribers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocol.codecs import json


class Publication:
    """A complete message of a topic, and the frames made of it.

    Args:
        topic: fully qualified name of the topic.
        type_name: canonical name of the message's type.
        msg: the message as `protocol.messages.complete` returns it; not to be changed from here on.
    """

    __slots__ = ("_encoded_msg", "_frames", "msg", "topic", "type_name")

    def __init__(self, topic: str, type_name: str, msg: Mapping[str, Any]) -> None:
        self.topic = topic
        self.type_name = type_name
        self.msg = msg
        self._encoded_msg: bytes | None = None
        # Subscribers spell a topic with or without its leading slash, so there are never more than two.
        self._frames: dict[str, bytes] = {}

    def frame(self, spelled_topic: str) -> bytes:
        """Return the JSON frame for subscribers that spell the topic like this."""
        frame = self._frames.get(spelled_topic)
        if frame is None:
            frame = self._frames[spelled_topic] = self._encode(spelled_topic)
        return frame

    def _encode(self, spelled_topic: str) -> bytes:
        if self._encoded_msg is None:
            self._encoded_msg = json.encode(self.msg)
        # rosbridge sends exactly these three keys; the message, the costly part, is spliced in as it was
        # encoded.
        return b'{"op":"publish","topic":%b,"msg":%b}' % (json.encode(spelled_topic), self._encoded_msg)
