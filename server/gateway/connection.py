"""One WebSocket: what comes in goes to the client, what the client has to say goes out."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from protocol.limits import Limits
from server.gateway.client import Client
from server.graph import Graph

log = logging.getLogger("armbridge.gateway")

# RFC 6455 7.4.1: the client broke a rule of ours (it does not read its replies).
POLICY_VIOLATION = 1008


class Connection:
    """The socket of one client.

    Args:
        websocket: the open connection.
        graph: what the client takes part in.
        limits: what the client may cost.
    """

    def __init__(self, websocket: ServerConnection, graph: Graph, limits: Limits) -> None:
        self._websocket = websocket
        self._wake = asyncio.Event()
        self._client = Client(f"client {_address(websocket)}", graph, limits, time.monotonic, self._wake.set)

    async def run(self) -> None:
        """Serve the client until it leaves."""
        log.info("%s connected", self._client.node)
        writer = asyncio.create_task(self._write(), name=f"write to {self._client.node}")
        try:
            await self._read()
        finally:
            writer.cancel()
            with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                await writer
            self._client.leave()

    async def _read(self) -> None:
        try:
            async for frame in self._websocket:
                self._client.receive_frame(frame)
                # A client that floods us gets its turn, no more: others are served between its frames.
                await asyncio.sleep(0)
        except ConnectionClosed as closed:
            log.warning("%s: connection closed: %s", self._client.node, closed)
        else:
            log.info("%s left", self._client.node)

    async def _write(self) -> None:
        session = self._client.session
        while True:
            self._wake.clear()
            for frame in session.data_to_send(time.monotonic()):
                await self._websocket.send(frame, text=True)
            if session.overflowed:
                log.warning("%s: does not read its replies; closing", self._client.node)
                await self._websocket.close(POLICY_VIOLATION, "replies are not read")
                return
            await self._until_something_is_due()

    async def _until_something_is_due(self) -> None:
        now_s = time.monotonic()
        due_s = self._client.session.next_due(now_s)
        if due_s is None:
            await self._wake.wait()
            return
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._wake.wait(), due_s - now_s)


def _address(websocket: ServerConnection) -> str:
    address = websocket.remote_address
    return f"{address[0]}:{address[1]}" if isinstance(address, tuple) else str(address)
