"""Is the server's event loop ever blocked, whatever is planned?

The server runs in this process beside a task that wants to run every millisecond. Its lateness in wall time contains
what the machine's other processes take away; the CPU time that the loop spends between two of its turns does not, and
is an upper bound on how long anything of ours held the loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import time

import uvloop

from benchmarks.figures import percentiles, print_table
from server.app import App
from server.config import load

QUIET_S = 5.0
LOAD_S = 15.0
TICK_S = 0.001
PORT = 9199


class Ticker:
    """A task that wants its turn every millisecond, and notes what it got."""

    def __init__(self) -> None:
        self.lateness_s: list[float] = []
        self.cpu_s: list[float] = []

    async def run(self) -> None:
        """Tick until cancelled."""
        due_s = time.monotonic() + TICK_S
        cpu_s = time.thread_time()
        while True:
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))
            now_s, now_cpu_s = time.monotonic(), time.thread_time()
            self.lateness_s.append(now_s - due_s)
            self.cpu_s.append(now_cpu_s - cpu_s)
            due_s, cpu_s = now_s + TICK_S, now_cpu_s

    def row(self, load: str) -> list[str]:
        """The figures of this load; the ticker starts afresh."""
        lateness_s, self.lateness_s = self.lateness_s, []
        cpu_s, self.cpu_s = self.cpu_s, []
        return [load, str(len(cpu_s)), *percentiles(lateness_s, 50, 99, 100), *percentiles(cpu_s, 99, 100)]


def run() -> None:
    """Serve a client that plans without pause."""
    rows: list[list[str]] = []
    uvloop.run(_measure(rows))
    print_table(
        "Event loop of the server [ms]",
        ["load", "ticks", "late p50", "late p99", "late max", "CPU between ticks p99", "max"],
        rows,
    )


async def _measure(rows: list[list[str]]) -> None:
    serving = asyncio.create_task(App(load(None, {"server": {"port": PORT}})).run())
    await asyncio.sleep(4.0)
    ticker = Ticker()
    ticking = asyncio.create_task(ticker.run())
    await asyncio.sleep(QUIET_S)
    rows.append(ticker.row("at rest"))
    client = await asyncio.create_subprocess_exec(sys.executable, "-m", "benchmarks.goal_flood", str(PORT), str(LOAD_S))
    await asyncio.sleep(LOAD_S)
    rows.append(ticker.row("planning without pause"))
    ticking.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await ticking
    await asyncio.wait_for(client.wait(), LOAD_S)
    os.kill(os.getpid(), signal.SIGTERM)
    await serving
