"""The gateway beside a bare relay, in one run: what validation, queues and limits cost.

Load and clients are processes of their own, so that the CPU time of the server's process is the server's alone.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import psutil

from benchmarks.figures import print_table

SERVERS = {"gateway": ("benchmarks.bare_gateway", 9391), "relay": ("benchmarks.relay", 9392)}
START_S = 1.5

FAN_OUTS = (1, 8, 32, 64, 128)

# What the gateway may cost, as a multiple of the relay (for the rate: at least that share of it).
LIMITS = {"fan-out": 1.3, "rate": 0.5, "service": 1.5, "string": 2.0, "deaf": 1.2}


def run() -> None:
    """Measure both, one after the other, load by load."""
    rows = []
    with _running() as servers:
        for count in FAN_OUTS:
            cpu = {name: _per_delivery_us(servers[name], ["fan_out", str(count)]) for name in SERVERS}
            rows.append(_row(f"fan-out to {count}, CPU us per delivery", cpu, LIMITS["fan-out"]))
        rate = {name: _load(name, ["flood"])["rate"] for name in SERVERS}
        rows.append(_row("client to client, messages/s", rate, LIMITS["rate"], at_least=True))
        trip = {name: _load(name, ["service"])["median_s"] * 1e6 for name in SERVERS}
        rows.append(_row("service round trip, median us", trip, LIMITS["service"]))
        large = {name: _per_delivery_us(servers[name], ["large"]) for name in SERVERS}
        rows.append(_row("String of 1 MiB, CPU us per delivery", large, LIMITS["string"]))
        deaf = _deaf_subscriber()
        rows.append(_row("p99 latency of 8 with a ninth that never reads, us", deaf, LIMITS["deaf"]))
    print_table("Gateway beside a bare relay", ["load", "gateway", "reference", "ratio", "goal"], rows)


def _row(load: str, values: dict[str, float], limit: float, *, at_least: bool = False) -> list[str]:
    ratio = values["gateway"] / values["relay"]
    return [
        load,
        f"{values['gateway']:.1f}",
        f"{values['relay']:.1f}",
        f"{ratio:.2f}",
        f"{'>=' if at_least else '<='} {limit}",
    ]


@contextlib.contextmanager
def _running() -> Iterator[dict[str, psutil.Process]]:
    started = {
        name: subprocess.Popen([sys.executable, "-m", module, str(port)], stderr=subprocess.DEVNULL)
        for name, (module, port) in SERVERS.items()
    }
    time.sleep(START_S)
    try:
        yield {name: psutil.Process(process.pid) for name, process in started.items()}
    finally:
        for process in started.values():
            process.terminate()
            process.wait(5.0)


def _load(server: str, arguments: list[str]) -> dict[str, Any]:
    """Run one load against a server; what it measured."""
    port = SERVERS[server][1]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.gateway_load", str(port), *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    measured: dict[str, Any] = json.loads(done.stdout)
    return measured


def _per_delivery_us(server: psutil.Process, arguments: list[str]) -> float:
    name = next(name for name, (module, _) in SERVERS.items() if module in server.cmdline())
    before = sum(server.cpu_times()[:2])
    deliveries = _load(name, arguments)["deliveries"]
    return float((sum(server.cpu_times()[:2]) - before) / deliveries * 1e6)


def _deaf_subscriber() -> dict[str, float]:
    """The gateway with a subscriber that never reads, and without it as its own reference."""
    without = _load("gateway", ["latency", "0"])["p99_s"] * 1e6
    return {"gateway": _load("gateway", ["latency", "1"])["p99_s"] * 1e6, "relay": without}
