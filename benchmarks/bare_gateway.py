"""The server's gateway and graph alone, without arm and planners. Usage: ``python -m benchmarks.bare_gateway PORT``."""

from __future__ import annotations

import asyncio
import gc
import sys

import uvloop

from protocol.registry import Registry
from server.gateway.listener import Listener
from server.gateway.settings import ServerSettings
from server.graph.topics import Graph


async def main(port: int) -> None:
    """Serve until the process is ended."""
    # Clients of one address that come as fast as they are served.
    settings = ServerSettings(port=port, connections_per_s=10_000.0)
    listener = Listener(Graph(Registry.load()), settings)
    await listener.bind()
    await listener.open()
    gc.collect()
    gc.freeze()
    await asyncio.get_running_loop().create_future()


if __name__ == "__main__":
    uvloop.run(main(int(sys.argv[1])))
