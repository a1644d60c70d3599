"""Lateness that planning adds to the server's event loop.

The server runs in this process beside a task that wants to run every millisecond. Its lateness in wall time contains
the time that other processes of the machine take; the CPU time that the loop spends between two of its turns does not,
and is an upper bound on the time for which the server held the loop. Planning adds the lateness beside planners that
are never idle, minus that beside as many processes that compute something else at the planners' niceness.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Callable

import numpy as np
import uvloop
from numpy.typing import NDArray

from benchmarks.planning import EASY, LONG
from harness.figures import percentiles, print_table
from planners.pool import NICENESS, PlannerPool
from robot.description.robot_folder import built_in
from server.app import App
from server.config_loader import load

BUSY_PROGRAM = f"import os; os.nice({NICENESS})\nwhile True: sum(range(100_000))"

QUIET_S = 5.0
LOAD_S = 15.0

# Planning is compared with other loads in short turns, so that other load of the machine affects all alike.
TURNS = 12
TURN_S = 1.5
SETTLE_S = 0.1

TICK_S = 0.001
PORT = 9199


class Ticker:
    """Task that wants its turn every millisecond, and notes its lateness."""

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
        """Return the figures of this load and start afresh."""
        lateness_s, self.lateness_s = self.lateness_s, []
        cpu_s, self.cpu_s = self.cpu_s, []
        return [load, str(len(cpu_s)), *percentiles(lateness_s, 50, 99, 100), *percentiles(cpu_s, 99, 100)]


def run() -> None:
    """Plan beside a ticker alone, and serve a client that plans without pause."""
    added: list[list[str]] = []
    uvloop.run(_compare(added))
    print_table(
        f"Lateness of an event loop, {TURNS} turns of {TURN_S:g} s each [ms]",
        ["beside it", "late p50", "late p99", "late max", "CPU between ticks p99", "max"],
        added,
    )
    rows: list[list[str]] = []
    uvloop.run(_measure(rows))
    print_table(
        "Event loop of the server [ms]",
        ["load", "ticks", "late p50", "late p99", "late max", "CPU between ticks p99", "max"],
        rows,
    )


async def _compare(rows: list[list[str]]) -> None:
    pool = PlannerPool(built_in("so101").model)
    await pool.start()
    await pool.ask(EASY)
    loads: dict[str, Callable[[], contextlib.AbstractAsyncContextManager[None]]] = {
        "nothing": _nothing,
        "a busy process": _busy_process,
        "a planner at work": lambda: _planning(pool),
    }
    turns: dict[str, list[Ticker]] = defaultdict(list)
    for _ in range(TURNS):
        for name, beside in loads.items():
            async with beside():
                turns[name].append(await _ticked())
    await pool.close()
    figures = {name: _pooled(tickers) for name, tickers in turns.items()}
    rows += [[name, *(f"{value:.2f}" for value in figure)] for name, figure in figures.items()]
    difference = figures["a planner at work"] - figures["a busy process"]
    rows.append(["added by planning to a busy process", *(f"{value:+.2f}" for value in difference)])


async def _ticked() -> Ticker:
    await asyncio.sleep(SETTLE_S)
    ticker = Ticker()
    ticking = asyncio.create_task(ticker.run())
    await asyncio.sleep(TURN_S)
    ticking.cancel()
    return ticker


def _pooled(tickers: list[Ticker]) -> NDArray[np.float64]:
    """Return lateness p50, p99 and max, and CPU time between ticks p99 and max [ms]."""
    lateness_s = np.concatenate([ticker.lateness_s for ticker in tickers])
    cpu_s = np.concatenate([ticker.cpu_s for ticker in tickers])
    figures_s = [*np.percentile(lateness_s, [50, 99, 100]), *np.percentile(cpu_s, [99, 100])]
    return 1e3 * np.array(figures_s, dtype=np.float64)


@contextlib.asynccontextmanager
async def _nothing() -> AsyncIterator[None]:
    yield


@contextlib.asynccontextmanager
async def _busy_process() -> AsyncIterator[None]:
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", BUSY_PROGRAM)
    yield
    process.kill()
    await process.wait()


@contextlib.asynccontextmanager
async def _planning(pool: PlannerPool) -> AsyncIterator[None]:
    planning = asyncio.create_task(_plan_for_ever(pool))
    yield
    planning.cancel()
    await asyncio.wait([planning])


async def _plan_for_ever(pool: PlannerPool) -> None:
    """Plan hard and easy motions without end, and cancel some, as clients do."""
    while True:
        await pool.ask(EASY)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(pool.ask(LONG), 0.2)


async def _measure(rows: list[list[str]]) -> None:
    serving = asyncio.create_task(App(load(None, {"server": {"port": PORT}})).run())
    await asyncio.sleep(4.0)
    ticker = Ticker()
    ticking = asyncio.create_task(ticker.run())
    await asyncio.sleep(QUIET_S)
    rows.append(ticker.row("at rest"))
    client = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "benchmarks.flood_clients", "goals", f"ws://127.0.0.1:{PORT}", str(LOAD_S)
    )
    await asyncio.sleep(LOAD_S)
    rows.append(ticker.row("planning without pause"))
    ticking.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await ticking
    await asyncio.wait_for(client.wait(), LOAD_S)
    os.kill(os.getpid(), signal.SIGTERM)
    await serving
