"""A listener on a free port, without the rest of the server, and requests to it to the letter."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from protocol.registry import Registry
from server.config import ServerSettings
from server.gateway.http import HttpHandler
from server.gateway.listener import Listener
from server.graph.topics import Graph

REGISTRY = Registry.load()
TIMEOUT_S = 30.0

# What a client sends to become a WebSocket's, without the lines that tests are about.
UPGRADE = (
    "Upgrade: websocket",
    "Connection: Upgrade",
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
    "Sec-WebSocket-Version: 13",
)


@asynccontextmanager
async def listening(settings: ServerSettings | None = None, http: HttpHandler | None = None) -> AsyncIterator[Listener]:
    """A listener that serves."""
    listener = Listener(Graph(REGISTRY), settings or ServerSettings(port=0), http)
    await listener.bind()
    await listener.open()
    try:
        yield listener
    finally:
        await listener.close()


def request(*lines: str, path: str = "/", host: str | None = "localhost") -> bytes:
    """A request; ``host`` None leaves its header out."""
    named = () if host is None else (f"Host: {host}",)
    return "\r\n".join((f"GET {path} HTTP/1.1", *named, *lines, "", "")).encode("latin-1")


async def exchange(port: int, sent: bytes) -> str:
    """Send, and read until the server ends the connection or has answered; empty for no answer."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(sent)
        async with asyncio.timeout(TIMEOUT_S):
            head = await reader.readuntil(b"\r\n\r\n")
            body = b"" if head.startswith(b"HTTP/1.1 101") else await reader.read()
        return (head + body).decode()
    except (asyncio.IncompleteReadError, ConnectionError):
        return ""
    finally:
        writer.close()


def status(answer: str) -> int:
    """The number of an answer; 0 for none."""
    return int(answer.split(" ", 2)[1]) if answer else 0
