"""Gateway compared with a bare relay, in one run: the cost of validation, queues and limits.

Load and clients are processes of their own, so that the CPU time of the server's process is the server's alone. The two
servers take turns at each load, several times, and the medians count: other load of the machine then affects both
alike.
"""

from __future__ import annotations

import contextlib
import json
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import NamedTuple

from harness.figures import print_table

SERVERS = {"gateway": ("benchmarks.bare_gateway", 9391), "relay": ("benchmarks.relay", 9392)}
START_TIMEOUT_S = 30.0
ROUNDS = 3

FAN_OUTS = (1, 8, 32, 64, 128)

# Upper bound of the gateway's cost as a multiple of the relay's; lower bound of its rate as a share.
FAN_OUT, RATE, SERVICE, STRING, PICTURE, DEAF = 1.25, 0.7, 1.2, 1.3, 1.5, 1.2
CONNECTIONS = 0.8


class Run(NamedTuple):
    """One load on one server: the server's name, and the load with its argument."""

    server: str
    load: tuple[str, ...]


def run() -> None:
    """Measure both, one after the other, load by load."""
    rows = []
    with running() as pids:
        for count in FAN_OUTS:
            fan_out = _beside_relay(pids, "fan_out", str(count))
            rows.append(_row(f"fan-out to {count}, CPU us per delivery", fan_out, "cpu_us", f"<= {FAN_OUT}"))
        flood = _beside_relay(pids, "flood")
        rows.append(_row("client to client, messages/s", flood, "rate", f">= {RATE}"))
        service = _beside_relay(pids, "service")
        rows.append(_row("service round trip, median us", service, "median_us", f"<= {SERVICE}"))
        large = _beside_relay(pids, "large")
        rows.append(_row("String of 1 MiB, CPU us per delivery", large, "cpu_us", f"<= {STRING}"))
        picture = _beside_relay(pids, "picture")
        rows.append(_row("CompressedImage of 1 MiB, CPU us per delivery", picture, "cpu_us", f"<= {PICTURE}"))
        connections = _beside_relay(pids, "connections")
        rows.append(_row("connections/s, each with one subscription", connections, "rate", f">= {CONNECTIONS}"))
        # The gateway is its own reference here, without the client that never reads.
        deaf = _medians(pids, Run("gateway", ("latency", "1")), Run("gateway", ("latency", "0")))
        rows.append(_row("p99 latency of 8 with a ninth that never reads, us", deaf, "p99_us", f"<= {DEAF}"))
    print_table("Gateway beside a bare relay", ["load", "gateway", "reference", "ratio", "goal"], rows)


def _row(load: str, measured: list[dict[str, float]], figure: str, goal: str) -> list[str]:
    gateway, reference = (figures[figure] for figures in measured)
    return [load, f"{gateway:.1f}", f"{reference:.1f}", f"{gateway / reference:.2f}", goal]


@contextlib.contextmanager
def running() -> Iterator[dict[str, int]]:
    """Run both servers; yields the ids of their processes."""
    started = {
        name: subprocess.Popen([sys.executable, "-m", module, str(port)], stderr=subprocess.DEVNULL)
        for name, (module, port) in SERVERS.items()
    }
    try:
        for _, port in SERVERS.values():
            _wait_for(port)
        yield {name: process.pid for name, process in started.items()}
    finally:
        for process in started.values():
            process.terminate()
            process.wait(5.0)


def _wait_for(port: int) -> None:
    """Wait until a server accepts connections."""
    ends_s = time.monotonic() + START_TIMEOUT_S
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
        except ConnectionRefusedError:
            if time.monotonic() > ends_s:
                raise
            time.sleep(0.05)
        else:
            return


def _beside_relay(pids: dict[str, int], *load: str) -> list[dict[str, float]]:
    """Return the figures of a load on the gateway, and on the relay."""
    return _medians(pids, *(Run(server, load) for server in SERVERS))


def _medians(pids: dict[str, int], *runs: Run) -> list[dict[str, float]]:
    """Return the medians of the figures of each run; the runs take turns."""
    measured = [[_measure(pids[one.server], one) for one in runs] for _ in range(ROUNDS)]
    return [
        {figure: statistics.median(figures[figure] for figures in rounds) for figure in rounds[0]}
        for rounds in zip(*measured, strict=True)
    ]


def _measure(pid: int, one: Run) -> dict[str, float]:
    """Run one load against a server and return its figures."""
    port = SERVERS[one.server][1]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.gateway_load", str(port), str(pid), *one.load],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    figures: dict[str, float] = json.loads(done.stdout)
    return figures
