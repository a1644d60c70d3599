"""Camera pictures through the gateway beside a bare relay: four readers, 30 Hz, 1 MiB on the wire.

The load is a program of its own, with clients of ``websockets``: ``python -m benchmarks.pictures PORT PID``. PID is the
server's process.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import random
import statistics
import subprocess
import sys
import time

import uvloop
from websockets.asyncio.client import ClientConnection, connect

from benchmarks.gateway import ROUNDS, SERVERS, running
from benchmarks.gateway_load import server_cpu_s
from harness.figures import print_table

READERS = 4
RATE_HZ = 30.0
SECONDS = 3.0
PICTURE_BYTES = 786_432
TOPIC, TYPE = "/pictures/image/compressed", "sensor_msgs/CompressedImage"

# Longer than pictures wait for the slowest machine; then those that are missing are lost.
QUIET_S = 3.0

START_TIMEOUT_S = 20.0


def run() -> None:
    """Measure both servers in turns, and print what each picture costs and whether all have come."""
    with running() as pids:
        rounds = [{name: _measure(name, pid) for name, pid in pids.items()} for _ in range(ROUNDS)]
    medians = {
        name: {figure: statistics.median(each[name][figure] for each in rounds) for figure in rounds[0][name]}
        for name in SERVERS
    }
    gateway, relay = medians["gateway"], medians["relay"]
    rows = [
        ["CPU of the server, ms per delivered MB", *_beside(gateway["cpu_ms"], relay["cpu_ms"])],
        ["median delay, ms", *_beside(gateway["delay_ms"], relay["delay_ms"])],
        ["greatest delay, ms", *_beside(gateway["greatest_delay_ms"], relay["greatest_delay_ms"])],
        ["pictures lost, of all", f"{gateway['lost']:.0f}", f"{relay['lost']:.0f}", "-"],
    ]
    title = f"Pictures of 1 MiB at {RATE_HZ:g} Hz to {READERS} readers"
    print_table(title, ["", "gateway", "relay", "ratio"], rows)


def _beside(gateway: float, relay: float) -> list[str]:
    return [f"{gateway:.2f}", f"{relay:.2f}", f"{gateway / relay:.2f}"]


def _measure(name: str, pid: int) -> dict[str, float]:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.pictures", str(SERVERS[name][1]), str(pid)],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    figures: dict[str, float] = json.loads(done.stdout)
    return figures


async def load(port: int, pid: int) -> dict[str, float]:
    """Publish pictures and read them; returns CPU time per MB [ms], delays [ms] and the number of lost ones."""
    url = f"ws://127.0.0.1:{port}"
    async with contextlib.AsyncExitStack() as clients:
        readers, publisher = [], await _client(clients, url)
        for _ in range(READERS):
            reader = await _client(clients, url)
            await reader.send(json.dumps({"op": "subscribe", "topic": TOPIC, "type": TYPE}))
            readers.append(reader)
        await publisher.send(json.dumps({"op": "advertise", "topic": TOPIC, "type": TYPE}))
        await asyncio.sleep(0.2)
        picture = base64.b64encode(random.Random(0).randbytes(PICTURE_BYTES)).decode()
        count = int(SECONDS * RATE_HZ)
        reading = [asyncio.create_task(_read(reader, count)) for reader in readers]
        began_cpu_s, due_s = server_cpu_s(pid), time.monotonic()
        for _ in range(count):
            msg = {"header": {"frame_id": repr(time.monotonic())}, "format": "jpeg", "data": picture}
            await publisher.send(json.dumps({"op": "publish", "topic": TOPIC, "msg": msg}))
            due_s += 1.0 / RATE_HZ
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))
        read = await asyncio.gather(*reading)
        cpu_s = server_cpu_s(pid) - began_cpu_s
    delays_s = [delay_s for delays, _ in read for delay_s in delays]
    return {
        "cpu_ms": 1e3 * cpu_s / (sum(size_bytes for _, size_bytes in read) / 1e6),
        "delay_ms": 1e3 * statistics.median(delays_s),
        "greatest_delay_ms": 1e3 * max(delays_s),
        "lost": count * READERS - len(delays_s),
    }


async def _client(clients: contextlib.AsyncExitStack, url: str) -> ClientConnection:
    # A busy machine takes a while to start a server.
    async with asyncio.timeout(START_TIMEOUT_S):
        while True:
            with contextlib.suppress(OSError):
                return await clients.enter_async_context(
                    connect(url, compression=None, max_size=None, ping_interval=None)
                )
            await asyncio.sleep(0.1)


async def _read(reader: ClientConnection, count: int) -> tuple[list[float], int]:
    """Read pictures, as bytes; returns their delays [s] and their size together."""
    delays_s: list[float] = []
    size_bytes = 0
    with contextlib.suppress(TimeoutError):
        while len(delays_s) < count:
            frame = await asyncio.wait_for(reader.recv(decode=False), QUIET_S)
            before, _, after = frame[:400].partition(b'"frame_id":')
            sent_s = float(after.split(b'"')[1]) if before else 0.0
            delays_s.append(time.monotonic() - sent_s)
            size_bytes += len(frame)
    return delays_s, size_bytes


if __name__ == "__main__":
    print(json.dumps(uvloop.run(load(int(sys.argv[1]), int(sys.argv[2])))))
