"""One WebSocket: what comes in goes to the client, what the client has to say goes out."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from urllib.parse import parse_qs, urlsplit

from websockets.exceptions import ConnectionClosed
from websockets.protocol import State

from protocol.dialect import Dialect
from protocol.limits import Limits
from protocol.parcel import Parcel
from server.access.access import Access, unlimited
from server.access.roles import ANYONE, Identity, Role, called
from server.gateway.client import Client
from server.gateway.client_auth import WayIn
from server.gateway.entrance.wrong_tokens import WrongTokens
from server.gateway.traffic import TrafficCounts
from server.gateway.websocket import TURN_S, WebSocket, address_of
from server.graph import Graph
from server.node import Node

log = logging.getLogger("armbridge.gateway")

# RFC 6455 7.4.1: the client broke a rule of ours, such as to read its replies.
POLICY_VIOLATION = 1008

# How long a client that does not read may take to hear why it is closed.
CLOSE_TIMEOUT_S = 1.0

# RFC 6455 5.5: what a close frame has room for beside its code.
MAX_REASON_BYTES = 123

# How long a client that has to say who it is may take for that.
AUTH_TIMEOUT_S = 10.0

# Until then; what a client sends right behind its auth, without waiting, is read under this limit as well. All that may
# connect from one address hold 100 MB so.
MAX_UNKNOWN_BYTES = 131_072

# Who may only look has nothing long to say, and a message of ten megabytes holds the server up for a second.
MAX_VIEW_BYTES = 1_048_576

# Of ``?on_disconnect=``: whether goals end with the connection.
_GOALS_END = {"stop": True, "finish": False}


class Connection:
    """The socket of one client.

    Args:
        websocket: the open connection.
        graph: what the client takes part in.
        limits: what the client may cost.
        takes_goals_along: whether its goals are cancelled when it leaves, unless its URL says otherwise.
        identity: who the client is; None for one that has yet to say so.
        access: who may do what; None for everybody everything.
        wrong_tokens: by address; None where nobody counts them.

    Attributes:
        address: where the client connects from.
    """

    def __init__(
        self,
        websocket: WebSocket,
        graph: Graph,
        limits: Limits,
        *,
        takes_goals_along: bool = False,
        identity: Identity | None = ANYONE,
        access: Access | None = None,
        wrong_tokens: WrongTokens | None = None,
    ) -> None:
        self._websocket = websocket
        # Made when something has to wait: most clients hardly ever hear so much.
        self._wake: asyncio.Event | None = None
        self._writer: asyncio.Task[None] | None = None
        self.address, port = address_of(websocket)
        place = f"{self.address}:{port}"
        self._closing: asyncio.Task[None] | None = None
        self._client = Client(
            called(identity, place),
            graph,
            limits,
            time.monotonic,
            self._wake_up,
            _dialect(websocket),
            websocket.send_at_once,
            identity,
            WayIn(access or unlimited(), self.address, wrong_tokens, self._shut_out, self._limit_messages),
        )
        self._client.node.address = place
        self._max_message_bytes = websocket.protocol.max_message_size
        self._limit_messages()
        asked = _query(websocket).get("on_disconnect", [""])[-1]
        self._client.node.takes_goals_along = _GOALS_END.get(asked, takes_goals_along)
        websocket.forget_handshake()

    @property
    def node(self) -> Node:
        """The client in the graph."""
        return self._client.node

    @property
    def queued_bytes(self) -> int:
        """What waits for the client to read."""
        return self._client.session.queued_bytes

    def counts(self) -> TrafficCounts:
        """What the client has said and heard until now."""
        websocket, client = self._websocket, self._client
        return TrafficCounts(
            received_messages=client.received_messages,
            received_bytes=websocket.received_bytes,
            sent_messages=websocket.sent_messages,
            sent_bytes=websocket.sent_bytes,
            dropped_messages=client.session.dropped,
            refused_operations=client.refused_operations,
        )

    async def run(self) -> None:
        """Serve the client until it leaves."""
        log.info("%s connected", self._client.node)
        waiting = None
        if self._client.node.identity is None:
            waiting = asyncio.get_running_loop().call_later(AUTH_TIMEOUT_S, self._see_who_it_is)
        try:
            self._websocket.on_message = self._client.receive_frame
            await self._read()
        finally:
            if waiting is not None:
                waiting.cancel()
            self._websocket.on_message = None
            await self._end_writer()
            self._client.leave()

    async def _end_writer(self) -> None:
        if self._writer is not None:
            self._writer.cancel()
            # It may have been waiting for a socket that broke.
            with contextlib.suppress(asyncio.CancelledError, OSError):
                await self._writer

    async def _read(self) -> None:
        turn_began_s = time.monotonic()
        try:
            async for frame in self._websocket:
                self._client.receive_frame(frame)
                # A client that floods us gets its turn, no more: others are served between its frames.
                if time.monotonic() - turn_began_s > TURN_S:
                    await asyncio.sleep(0)
                    turn_began_s = time.monotonic()
        except ConnectionClosed as closed:
            log.warning("%s: connection closed: %s", self._client.node, closed)
        else:
            log.info("%s left", self._client.node)

    async def _write(self, wake: asyncio.Event) -> None:
        """Send what could not be sent at once."""
        while self._websocket.state is State.OPEN:
            wake.clear()
            self._flush()
            await self._websocket.drain()
            await self._until_something_is_due(wake)

    def _wake_up(self) -> None:
        """Send what is due, or have it sent; a client whose replies pile up is closed, for it may never read them."""
        session = self._client.session
        if not session.overflowed:
            self._flush()
            if session.waiting:
                self._wake_writer()
        elif self._closing is None:
            log.warning("%s: does not read its replies; closing", self._client.node)
            self._shut_out("replies are not read")

    def _wake_writer(self) -> None:
        if self._wake is None:
            self._wake = asyncio.Event()
            self._writer = asyncio.create_task(self._write(self._wake), name=f"write to {self._client.node}")
        self._wake.set()

    def _limit_messages(self) -> None:
        """Larger messages end the connection before they are read."""
        identity, limit_bytes = self._client.node.identity, self._max_message_bytes
        if identity is None:
            limit_bytes = MAX_UNKNOWN_BYTES
        elif identity.role is Role.VIEW:
            limit_bytes = min(MAX_VIEW_BYTES, limit_bytes or MAX_VIEW_BYTES)
        self._websocket.protocol.max_message_size = limit_bytes

    def _see_who_it_is(self) -> None:
        if self._client.node.identity is None and self._closing is None:
            log.warning("%s: has not said who it is within %g s; closing", self._client.node, AUTH_TIMEOUT_S)
            self._shut_out(f"the op auth is wanted within {AUTH_TIMEOUT_S:g} s")

    def _shut_out(self, reason: str) -> None:
        if self._closing is None:
            self._closing = asyncio.create_task(self._close(reason), name=f"close {self._client.node}")

    async def _close(self, reason: str) -> None:
        """Say why, and end the connection even if the client hears nothing."""
        told = reason.encode()[:MAX_REASON_BYTES].decode(errors="ignore")
        with contextlib.suppress(TimeoutError, ConnectionClosed):
            await asyncio.wait_for(self._websocket.close(POLICY_VIOLATION, told), CLOSE_TIMEOUT_S)
        self._websocket.transport.abort()

    def _flush(self) -> None:
        """Send what is due, for as long as the socket takes it without waiting."""
        while self._websocket.takes_more:
            frames = self._client.session.data_to_send(time.monotonic())
            if not frames:
                return
            self._websocket.send_at_once(Parcel(*frames))

    async def _until_something_is_due(self, wake: asyncio.Event) -> None:
        now_s = time.monotonic()
        due_s = self._client.session.next_due(now_s)
        if due_s is None:
            await wake.wait()
            return
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(wake.wait(), due_s - now_s)


def _dialect(websocket: WebSocket) -> Dialect:
    """Which ROS the client asks for in its URL: ``?ros=1`` for ROS 1."""
    return "ros1" if _query(websocket).get("ros") == ["1"] else "ros2"


def _query(websocket: WebSocket) -> dict[str, list[str]]:
    """What the client asks for in its URL."""
    return parse_qs(urlsplit(websocket.request.path).query if websocket.request else "")
