"""Age of a joint state when a client receives it."""

from __future__ import annotations

import asyncio

from benchmarks.watch_states import watch
from harness.figures import percentiles, print_table
from harness.server import RunningServer

SECONDS = 10.0


def run() -> None:
    """Compare the stamp of each state with the time of its arrival; one machine, one clock."""
    with RunningServer() as server:
        ages_s = asyncio.run(watch(server.url, SECONDS))["ages_s"]
    print_table(
        "/joint_states: from the reading of the servos to the client [ms]",
        ["states", "p50", "p99", "max"],
        [[str(len(ages_s)), *percentiles(ages_s, 50, 99, 100)]],
    )
