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
from server.gateway.client import Client
from server.gateway.websocket import TURN_S, WebSocket
from server.graph import Graph
from server.node import Node

log = logging.getLogger("armbridge.gateway")

# RFC 6455 7.4.1: the client broke a rule of ours (it does not read its replies).
POLICY_VIOLATION = 1008

# How long a client that does not read may take to hear why it is closed.
CLOSE_TIMEOUT_S = 1.0

# Of ``?on_disconnect=``: whether goals end with the connection.
_GOALS_END = {"stop": True, "finish": False}


class Connection:
    """The socket of one client.

    Args:
        websocket: the open connection.
        graph: what the client takes part in.
        limits: what the client may cost.
        takes_goals_along: whether its goals are cancelled when it leaves, unless its URL says otherwise.

    Attributes:
        address: where the client connects from.
    """

    def __init__(self, websocket: WebSocket, graph: Graph, limits: Limits, *, takes_goals_along: bool = False) -> None:
        self._websocket = websocket
        self._wake = asyncio.Event()
        self.address, port = _address(websocket)
        name = f"client {self.address}:{port}"
        self._closing: asyncio.Task[None] | None = None
        self._client = Client(
            name, graph, limits, time.monotonic, self._wake_up, _dialect(websocket), websocket.send_at_once
        )
        asked = _query(websocket).get("on_disconnect", [""])[-1]
        self._client.node.takes_goals_along = _GOALS_END.get(asked, takes_goals_along)

    @property
    def node(self) -> Node:
        """The client in the graph."""
        return self._client.node

    async def run(self) -> None:
        """Serve the client until it leaves."""
        log.info("%s connected", self._client.node)
        writer = asyncio.create_task(self._write(), name=f"write to {self._client.node}")
        try:
            self._websocket.on_message = self._client.receive_frame
            await self._read()
        finally:
            self._websocket.on_message = None
            writer.cancel()
            # The writer may have been waiting for a socket that broke.
            with contextlib.suppress(asyncio.CancelledError, OSError):
                await writer
            self._client.leave()

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

    async def _write(self) -> None:
        """Send what could not be sent at once."""
        while self._websocket.state is State.OPEN:
            self._wake.clear()
            self._flush()
            await self._websocket.drain()
            await self._until_something_is_due()

    def _wake_up(self) -> None:
        """Send what is due, or have it sent; a client whose replies pile up is closed, for it may never read them."""
        session = self._client.session
        if not session.overflowed:
            self._flush()
            if session.waiting:
                self._wake.set()
        elif self._closing is None:
            log.warning("%s: does not read its replies; closing", self._client.node)
            self._closing = asyncio.create_task(self._close(), name=f"close {self._client.node}")

    async def _close(self) -> None:
        """Say why, and end the connection even if the client hears nothing."""
        with contextlib.suppress(TimeoutError, ConnectionClosed):
            await asyncio.wait_for(self._websocket.close(POLICY_VIOLATION, "replies are not read"), CLOSE_TIMEOUT_S)
        self._websocket.transport.abort()

    def _flush(self) -> None:
        """Send what is due, for as long as the socket takes it without waiting."""
        while self._websocket.takes_more:
            frames = self._client.session.data_to_send(time.monotonic())
            if not frames:
                return
            self._websocket.send_at_once(Parcel(*frames))

    async def _until_something_is_due(self) -> None:
        now_s = time.monotonic()
        due_s = self._client.session.next_due(now_s)
        if due_s is None:
            await self._wake.wait()
            return
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._wake.wait(), due_s - now_s)


def _address(websocket: WebSocket) -> tuple[str, int]:
    """Address and port of the client; a connection that broke off at once has none any more."""
    address = websocket.remote_address
    return (str(address[0]), int(address[1])) if isinstance(address, tuple) else ("unknown", 0)


def _dialect(websocket: WebSocket) -> Dialect:
    """Which ROS the client asks for in its URL: ``?ros=1`` for ROS 1."""
    return "ros1" if _query(websocket).get("ros") == ["1"] else "ros2"


def _query(websocket: WebSocket) -> dict[str, list[str]]:
    """What the client asks for in its URL."""
    return parse_qs(urlsplit(websocket.request.path).query if websocket.request else "")
