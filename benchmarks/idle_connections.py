"""Memory of the server per client that is connected and sends nothing."""

from __future__ import annotations

import asyncio
import contextlib
import time

import psutil
from websockets.asyncio.client import connect

from harness.figures import print_table
from harness.server import RunningServer

CONNECTIONS = 500
ROUNDS = 3

# Time for the server to come to rest.
SETTLE_S = 2.0

# Time for the planner workers to load, and for one-time allocations.
WARM_UP_S = 3.0


def run() -> None:
    """Measure with and without clients, several times, since memory is given back in part only."""
    with RunningServer() as server:
        process = psutil.Process(server.process.pid)
        asyncio.run(_connected(server.url, 1, process))
        time.sleep(WARM_UP_S)
        rows = [_round(server.url, process, number) for number in range(1, ROUNDS + 1)]
    print_table(
        f"{CONNECTIONS} idle connections", ["round", "MB before", "MB with them", "kB each", "MB after they left"], rows
    )


def _round(url: str, process: psutil.Process, number: int) -> list[str]:
    before = _memory_bytes(process)
    during = asyncio.run(_connected(url, CONNECTIONS, process))
    time.sleep(SETTLE_S)
    after = _memory_bytes(process)
    each_kb = (during - before) / CONNECTIONS / 1e3
    return [str(number), f"{before / 1e6:.1f}", f"{during / 1e6:.1f}", f"{each_kb:.1f}", f"{after / 1e6:.1f}"]


async def _connected(url: str, count: int, process: psutil.Process) -> int:
    """Return the memory of the server while a number of clients are connected [bytes]."""
    async with contextlib.AsyncExitStack() as stack:
        for _ in range(count):
            await stack.enter_async_context(connect(url, ping_interval=None))
        await asyncio.sleep(SETTLE_S)
        return _memory_bytes(process)


def _memory_bytes(process: psutil.Process) -> int:
    return int(process.memory_info().rss)


if __name__ == "__main__":
    run()
