"""Players of conformance cases on the sockets of a real listener."""

import asyncio
import json
from contextlib import AbstractAsyncContextManager
from typing import Any

import bson
from websockets.asyncio.client import ClientConnection, connect

from harness.waiting import until
from server.access.authorization import Access
from server.gateway.listener import Listener
from server.gateway.settings import ServerSettings
from server.gateway.transport import TcpStream
from server.graph.topics import Graph
from server.rosapi import RosApi
from tests.conformance.cases import play
from tests.helpers.gateway import REGISTRY, TIMEOUT_S, USER_REGISTRY, listening
from tests.helpers.raw_tcp import RawClient

# The server takes a frame from its queue and sends what comes of it in two or three.
TURNS = 10

# Its answer comes behind all that the server has for a client.
PROBE = {"op": "call_service", "service": "/nobody", "id": "is there anything before this?"}


def serving(graph: Graph, access: Access | None = None, **chosen: Any) -> AbstractAsyncContextManager[Listener]:
    """A listener on a free port, and one for raw TCP."""
    return listening(ServerSettings(port=0, tcp_port=0, **chosen), graph=graph, access=access)


class SocketPlayer:
    """Real clients of a listener, for the steps of a case; each is connected with its first step."""

    def __init__(self, listener: Listener, case: dict[str, Any]) -> None:
        self._listener = listener
        self._bson = {step["client"] for step in case["steps"] if "send_bson" in step}
        self._clients: dict[str, Any] = {}

    async def client(self, name: str) -> Any:
        if name not in self._clients:
            self._clients[name] = await self._connect(name)
        return self._clients[name]

    async def _connect(self, name: str) -> Any:
        raise NotImplementedError

    async def send(self, client: str, frame: str | bytes) -> None:
        raise NotImplementedError

    async def next_frame(self, client: str) -> str | bytes | None:
        raise NotImplementedError

    async def nothing_comes(self, client: str) -> bool:
        """Return true if the next frame is the answer to a call."""
        await self.send(client, bson.encode(PROBE) if client in self._bson else json.dumps(PROBE))
        frame = await self.next_frame(client)
        return frame is not None and PROBE["id"] in (frame if isinstance(frame, str) else frame.decode("latin-1"))

    async def close(self, client: str) -> None:
        clients = self._listener.traffic.clients
        await self._clients.pop(client).close()
        # The server's side of the close is not ordered with what other clients send next.
        await until(lambda: self._listener.traffic.clients < clients)

    async def advance(self, seconds: float) -> None:
        raise AssertionError("a case that lets time pass is not played on sockets")

    async def end(self) -> None:
        for client in self._clients.values():
            await client.close()


class OverWebSockets(SocketPlayer):
    async def _connect(self, name: str) -> ClientConnection:
        return await connect(f"ws://127.0.0.1:{self._listener.port}/any/path?x=1")

    async def send(self, client: str, frame: str | bytes) -> None:
        websocket = await self.client(client)
        await websocket.send(frame)
        # Once the pong is there, the server has the frame in its queue; it serves it in the next turns of its loop.
        await asyncio.wait_for(await websocket.ping(), TIMEOUT_S)
        for _ in range(TURNS):
            await asyncio.sleep(0)

    async def next_frame(self, client: str) -> str | bytes | None:
        return await asyncio.wait_for((await self.client(client)).recv(), TIMEOUT_S)


class OverTcp(SocketPlayer):
    async def _connect(self, name: str) -> RawClient:
        port = self._listener.tcp_port
        assert port is not None
        client = await RawClient.connect(port, speaks_bson=name in self._bson)
        await until_read(self._listener, client)
        return client

    async def send(self, client: str, frame: str | bytes) -> None:
        stream = await self.client(client)
        stream.write(frame.encode() if isinstance(frame, str) else frame)
        await until_read(self._listener, stream)

    async def next_frame(self, client: str) -> str | bytes | None:
        return await (await self.client(client)).next_frame()


def streams_of(listener: Listener) -> set[TcpStream]:
    """The connections of raw TCP that are open."""
    return {each for each in listener._transports if isinstance(each, TcpStream)}


async def until_read(listener: Listener, client: RawClient) -> None:
    """Wait until the server has read all that a client has sent, and has carried it out."""
    sent = client.address, client.sent_bytes
    await until(lambda: sent in {(each.peer, each.received_bytes) for each in streams_of(listener)})
    for _ in range(TURNS):
        await asyncio.sleep(0)


async def play_on(player: type[OverWebSockets | OverTcp], case: dict[str, Any]) -> None:
    """Play a case on a server of its own."""
    registry = USER_REGISTRY if case.get("interfaces") else REGISTRY
    graph = Graph(registry, relay_unknown_types=case.get("relay_unknown_types", False))
    if case.get("rosapi"):
        RosApi(graph)
    async with serving(graph, tcp_ros_version=2) as listener:
        playing = player(listener, case)
        try:
            await play(case, playing)
        finally:
            await playing.end()
