"""Memory and processor time of a classroom for each student: at rest, watched, and while all arms move."""

from __future__ import annotations

import asyncio
import contextlib
import csv
import itertools
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from harness.clients import FrameClient, frame_client
from harness.figures import print_table
from harness.server import FAST, ROOT, free_ports
from harness.waiting import until_classroom_ready

STUDENTS = 20
MEASURE_S = 20.0

# What is loaded behind the start has been loaded, and a first motion has ended.
SETTLE_S = 8.0
READY_TIMEOUT_S = 180.0

# Two named states of each arm, between which it moves.
ARMS = {"fetch": ("ready", "raised"), "so101": ("ready", "home")}


@dataclass(frozen=True)
class Cost:
    """Cost of processes over some time, for each student."""

    memory_mb: float  # proportional set size: what processes share counts once, in equal shares (proc(5), smaps_rollup)
    processor_percent: float  # processor time of one core

    @property
    def cells(self) -> list[str]:
        """The same for a table."""
        return [f"{self.memory_mb:.0f}", f"{self.processor_percent:.1f}"]


def run() -> None:
    """Measure a classroom of each arm, and one server on its own."""
    for arm, states in ARMS.items():
        rows = [["a server on its own, at rest", "1", *_alone(arm).cells, "-"]]
        with _classroom(arm) as (process, urls):
            rows += asyncio.run(_measure(process, urls, states))
        print_table(
            f"Classroom of {STUDENTS} {arm} arms, a student",
            ["condition", "servers", "memory MB", "CPU % of a core", "goals a minute, reached / others"],
            rows,
        )


async def _measure(process: psutil.Process, urls: Sequence[str], states: Sequence[str]) -> list[list[str]]:
    count = str(len(urls))
    await asyncio.sleep(SETTLE_S)
    rows = [["at rest, no client", count, *(await _cost(process, len(urls))).cells, "-"]]
    async with contextlib.AsyncExitStack() as stack:
        clients = [await stack.enter_async_context(frame_client(url)) for url in urls]
        for client in clients:
            await client.open_goals()
        rows.append(["at rest, a client each", count, *(await _cost(process, len(urls))).cells, "-"])
        for client in clients:
            await client.subscribe("/joint_states", "sensor_msgs/JointState")
        rows.append(["at rest, /joint_states subscribed", count, *(await _cost(process, len(urls))).cells, "-"])
        codes: list[int] = []
        moving = [asyncio.create_task(_move(client, states, codes)) for client in clients]
        await asyncio.sleep(SETTLE_S)
        codes.clear()
        cost = await _cost(process, len(urls))
        reached, others = codes.count(1), len(codes) - codes.count(1)
        for task in moving:
            task.cancel()
        await asyncio.gather(*moving, return_exceptions=True)
        a_minute = 60.0 / MEASURE_S
        rows.append(["all move", count, *cost.cells, f"{reached * a_minute:.0f} / {others * a_minute:.0f}"])
    return rows


async def _move(client: FrameClient, states: Sequence[str], codes: list[int]) -> None:
    """Move to and fro, and note the code of each result."""
    for state in itertools.cycle(states):
        result = await client.reach("/moveit_goal_named", {"data": state})
        codes.append(int(result["val"]))


async def _cost(process: psutil.Process, students: int) -> Cost:
    """Measure a process and all behind it for a while."""
    before_s, began_s = _processor_s(process), time.monotonic()
    await asyncio.sleep(MEASURE_S)
    spent = (_processor_s(process) - before_s) / (time.monotonic() - began_s)
    memory = sum(_memory_bytes(each.pid) for each in _family(process))
    return Cost(memory / students / 1e6, 100.0 * spent / students)


def _family(process: psutil.Process) -> list[psutil.Process]:
    return [process, *process.children(recursive=True)]


def _processor_s(process: psutil.Process) -> float:
    return sum(sum(each.cpu_times()[:2]) for each in _family(process))


def _memory_bytes(pid: int) -> int:
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("Pss:"))


def _alone(arm: str) -> Cost:
    with _started(
        "serve", "--robot", arm, "--port", "0", "--set", "scene.keep=false", ready="armbridge is ready"
    ) as one:
        return asyncio.run(_settled_cost(one))


async def _settled_cost(process: psutil.Process) -> Cost:
    await asyncio.sleep(SETTLE_S)
    return await _cost(process, 1)


@contextlib.contextmanager
def _classroom(arm: str) -> Iterator[tuple[psutil.Process, list[str]]]:
    """A classroom, and the addresses of its servers with their tokens."""
    with tempfile.TemporaryDirectory() as folder:
        options = ["--students", str(STUDENTS), "--port", str(free_ports(STUDENTS)), "--data", folder, "--robot", arm]
        with _started("classroom", *options, ready="students.csv") as process:
            until_classroom_ready(students := Path(folder) / "students.csv")
            with students.open(newline="") as lines:
                places = [row for row in csv.DictReader(lines) if row["name"] != "teacher"]
            yield process, [f"{row['url']}/?token={row['token']}" for row in places]


@contextlib.contextmanager
def _started(command: str, *options: str, ready: str) -> Iterator[psutil.Process]:
    """A command that runs, from the line that says so."""
    started = subprocess.Popen(
        [sys.executable, "-m", "server.cli", command, *options],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), **FAST},
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert started.stderr is not None
        until_s = time.monotonic() + READY_TIMEOUT_S
        while ready not in (line := started.stderr.readline()):
            if not line or time.monotonic() > until_s:
                raise RuntimeError(f"armbridge {command} did not start: {line}")
        yield psutil.Process(started.pid)
    finally:
        started.send_signal(signal.SIGINT)
        started.wait(READY_TIMEOUT_S)


if __name__ == "__main__":
    run()
