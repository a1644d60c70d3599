"""Start-up time, and the cost of each process at rest."""

from __future__ import annotations

import time

import psutil

from harness.figures import percentiles, print_table
from harness.server import RunningServer

STARTS = 5
REST_S = 10.0

WARM_UP_S = 3.0  # the planner workers load their libraries behind the start

NAMES = {"robot.control.loop": "arm", "planners.worker": "planner"}


def run() -> None:
    """Start the server several times; measure the processes of the last one at rest."""
    starts_s = []
    for number in range(STARTS):
        started_s = time.monotonic()
        with RunningServer() as server:
            starts_s.append(time.monotonic() - started_s)
            if number == STARTS - 1:
                rows = _at_rest(psutil.Process(server.process.pid))
    print_table(
        "Start of the process to the ready line [s]",
        ["starts", "median", "max"],
        [[str(STARTS), *percentiles(starts_s, 50, 100, scale=1.0)]],
    )
    print_table("At rest, no client", ["process", "CPU % of a core", "memory MB, shared parts divided"], rows)


def _at_rest(server: psutil.Process) -> list[list[str]]:
    time.sleep(WARM_UP_S)
    found = [server, *server.children(recursive=True)]
    for process in found:
        process.cpu_percent()
    time.sleep(REST_S)
    return [[_name(each), f"{each.cpu_percent():.1f}", f"{each.memory_full_info().pss / 1e6:.0f}"] for each in found]


def _name(process: psutil.Process) -> str:
    command = process.cmdline()
    return next((name for module, name in NAMES.items() if module in command), "server")
