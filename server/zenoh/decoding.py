"""Messages from the network, decoded: small ones at once, large ones by a thread, which delays nobody else."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from protocol.codecs import cdr
from protocol.errors import MessageError
from server.gateway.turns import Background
from server.graph.message_types import BYTES_AT_ONCE, MessageTypes, ReceivedMessage

# Called in the event loop with the message, or with the reason why there is none.
Decoded: TypeAlias = Callable[[ReceivedMessage | MessageError], None]


class Decoder:
    """Decoder of CDR."""

    def __init__(self, message_types: MessageTypes, background: Background) -> None:
        self._message_types = message_types
        self._background = background

    def decode(self, type_name: str, octets: bytes, decoded: Decoded) -> None:
        """Decode a message."""
        if len(octets) <= BYTES_AT_ONCE:
            decoded(self._completed(type_name, octets))
            return
        failed = MessageError(type_name, "a message that cannot be decoded")
        self._background.run(
            lambda: self._completed(type_name, octets),
            lambda message, _cost_s: decoded(message),
            lambda: decoded(failed),
        )

    def _completed(self, type_name: str, octets: bytes) -> ReceivedMessage | MessageError:
        try:
            message = cdr.deserialize(self._message_types.registry, type_name, octets)
        except MessageError as error:
            return error
        received = ReceivedMessage(message, len(octets))
        received.complete(self._message_types, type_name)
        return received
