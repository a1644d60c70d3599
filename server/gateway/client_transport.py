"""Transport of a client's frames, as a connection sees it: a WebSocket, or a raw TCP stream."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from typing import Protocol, cast

from protocol.publication import EncodedMessage
from server.gateway.inbox import Reader
from server.graph.permissions import Identity

# SO_LINGER of no time: the connection is reset, and leaves no TIME_WAIT of two minutes in the kernel's table, which a
# flood would fill.
_RESET = struct.pack("ii", 1, 0)


class ClientTransport(Reader, Protocol):
    """Transport of one client.

    Iterating over it gives the frames that were not handed over by `start_delivery`, and ends with the connection:
    by an error when that was broken off.

    Attributes:
        framed: True where the client gets messages one by one; in a stream it may take two for one.
        identity: identity of the client; None until it has authenticated.
        received_bytes: bytes received.
        sent_messages: frames sent; a fragment is one.
        sent_bytes: bytes of these frames.
    """

    framed: bool
    identity: Identity | None
    received_bytes: int
    sent_messages: int
    sent_bytes: int

    @property
    def max_message_bytes(self) -> int | None:
        """Size of a received frame beyond which the connection ends; None for any."""

    @max_message_bytes.setter
    def max_message_bytes(self, limit_bytes: int | None) -> None: ...

    @property
    def peer(self) -> tuple[str, int]:
        """IP address and port of the client."""

    @property
    def query(self) -> Mapping[str, Sequence[str]]:
        """Choices of the client for its connection, as a URL's query has them: ``ros``, ``on_disconnect``."""

    @property
    def is_open(self) -> bool:
        """True while frames can be sent."""

    @property
    def takes_more(self) -> bool:
        """True while the socket takes a message without waiting."""

    def send_at_once(self, encoded: EncodedMessage) -> bool:
        """Send a message, in order of calling, if the socket takes it without waiting; return True when it is sent."""

    def send_all(self, messages: Sequence[EncodedMessage]) -> None:
        """Send messages that have waited, while `takes_more` is true."""

    @property
    def taken_bytes(self) -> int:
        """Bytes of frames that the socket has taken: they grow as long as the client reads."""

    async def drain(self) -> None:
        """Wait until the socket takes more."""

    def start_delivery(self, on_message: Callable[[str | bytes], None]) -> None:
        """Hand frames over as they come.

        Args:
            on_message: called with a frame, text or bytes; must not raise.
        """

    def stop_delivery(self) -> None:
        """Hand no more frames over."""

    def __aiter__(self) -> AsyncIterator[str | bytes]: ...

    async def close(self, code: int, reason: str) -> None:
        """Close the connection and wait until that is done.

        Args:
            code: of a WebSocket's close frame (RFC 6455, 7.4).
            reason: one sentence for the client.
        """

    def abort(self) -> None:
        """End the connection now."""


def address_and_port(peer: object) -> tuple[str, int]:
    """Return IP address and port of a socket's peer; a connection that broke off at once has none any more."""
    return (str(peer[0]), int(peer[1])) if isinstance(peer, tuple) else ("unknown", 0)


def reset(transport: asyncio.BaseTransport) -> None:
    """End a connection without an answer."""
    transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
    cast(asyncio.Transport, transport).abort()
