"""Reference for the gateway: the smallest relay that can be written on the same libraries.

asyncio on uvloop, ``websockets`` and its ``broadcast``, orjson; no types, no validation, no queues, no limits. Usage:
``python -m benchmarks.relay PORT``.
"""

from __future__ import annotations

import asyncio
import sys
from collections import defaultdict
from typing import Any

import orjson
import uvloop
from websockets.asyncio.server import ServerConnection, broadcast, serve
from websockets.exceptions import ConnectionClosed

subscribers: dict[str, set[ServerConnection]] = defaultdict(set)
providers: dict[str, ServerConnection] = {}
callers: dict[str, tuple[ServerConnection, Any]] = {}
latched: dict[str, bytes] = {}


async def handle(websocket: ServerConnection) -> None:
    """Relay one client's frames."""
    # Bytes, for orjson checks their UTF-8 as it reads them.
    while True:
        try:
            frame = await websocket.recv(decode=False)
        except ConnectionClosed:
            break
        operation = orjson.loads(frame)
        match operation["op"]:
            case "subscribe":
                subscribers[operation["topic"]].add(websocket)
                if operation["topic"] in latched:
                    await websocket.send(latched[operation["topic"]], text=True)
            case "publish":
                out = orjson.dumps({"op": "publish", "topic": operation["topic"], "msg": operation["msg"]})
                broadcast(subscribers[operation["topic"]], out, text=True)
                if operation.get("latch"):
                    latched[operation["topic"]] = out
            case "advertise_service":
                providers[operation["service"]] = websocket
            case "call_service":
                number = str(len(callers))
                callers[number] = (websocket, operation["id"])
                await providers[operation["service"]].send(orjson.dumps({**operation, "id": number}), text=True)
            case "service_response":
                caller, operation["id"] = callers.pop(operation["id"])
                await caller.send(orjson.dumps(operation), text=True)
    for each in subscribers.values():
        each.discard(websocket)


async def main(port: int) -> None:
    """Serve until the process is ended."""
    async with serve(handle, "127.0.0.1", port, compression=None, max_size=None):
        await asyncio.get_running_loop().create_future()


if __name__ == "__main__":
    uvloop.run(main(int(sys.argv[1])))
