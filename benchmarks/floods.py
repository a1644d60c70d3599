"""Effect of a flooding client on another client: ``python -m benchmarks.floods [--seconds S] [KIND ...]``.

Quiet and flooded phases take turns, so that both run under the same conditions. The flooding process has the lowest
priority: it takes time from the others through the server's work for it, not through the scheduler.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field

import numpy as np
import psutil

from benchmarks.flood_clients import FLOODS
from harness.figures import print_table
from harness.server import ROOT, RunningServer

SECONDS = 10.0
TURNS = 3

# Time for loading the planner workers, and for start and end of the flood, outside the phases.
WARM_UP_S = 3.0
SETTLE_S = 0.5
CONNECT_S = 1.0
TIMEOUT_S = 30.0

NICENESS = 19
GOAL = 1.5


@dataclass
class Phase:
    """Observations of one client of ``/joint_states``: age of each state [s] and time since the one before it [s]."""

    ages_s: list[float] = field(default_factory=list)
    intervals_s: list[float] = field(default_factory=list)

    def p99_ms(self) -> tuple[float, float]:
        """Return p99 of the ages and of the intervals [ms]."""
        return float(np.percentile(self.ages_s, 99) * 1e3), float(np.percentile(self.intervals_s, 99) * 1e3)


def run(seconds: float = SECONDS, kinds: tuple[str, ...] = tuple(FLOODS)) -> None:
    """Flood a server in each way in turn."""
    with RunningServer() as server:
        log = DrainedLog(server)
        process = psutil.Process(server.process.pid)
        time.sleep(WARM_UP_S)
        rows = [_measured(kind, server, process, seconds) for kind in kinds]
        log.close()
    print_table(
        f"/joint_states at a client while another one floods, {TURNS} times {seconds:g} s each [ms]",
        ["flood", "age p99 quiet", "flooded", "ratio", "interval p99 quiet", "flooded", "ratio", "server MB, by turn"],
        rows,
    )
    print(f"Goal: at most {GOAL:g} times the quiet p99, and memory that does not grow.")


class DrainedLog:
    """Thread that trims the kept log lines of the server, which would grow in this process during a flood."""

    def __init__(self, server: RunningServer) -> None:
        self._lines = server.lines
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._drain, daemon=True)
        self._thread.start()

    def _drain(self) -> None:
        while not self._done.wait(1.0):
            del self._lines[:-100]

    def close(self) -> None:
        """Stop trimming."""
        self._done.set()
        self._thread.join()


def _measured(kind: str, server: RunningServer, process: psutil.Process, seconds: float) -> list[str]:
    quiet, flooded, memory_mb = Phase(), Phase(), []
    for _ in range(TURNS):
        with _watching(server.url, seconds, quiet):
            pass
        # The watching client connects before the flood: the rate of connections per address is limited.
        with _flooding(kind, server.url, _watching(server.url, seconds, flooded)):
            memory_mb.append(process.memory_info().rss / 1e6)
        time.sleep(SETTLE_S)
    return [kind, *_compared(quiet, flooded), " ".join(f"{each:.0f}" for each in memory_mb)]


def _compared(quiet: Phase, flooded: Phase) -> list[str]:
    cells = []
    for before, during in zip(quiet.p99_ms(), flooded.p99_ms(), strict=True):
        cells += [f"{before:.2f}", f"{during:.2f}", f"{during / before:.2f}"]
    return cells


@contextmanager
def _flooding(kind: str, url: str, watching: AbstractContextManager[None]) -> Iterator[None]:
    command = [sys.executable, "-m", "benchmarks.flood_clients", kind, url, "3600"]
    with watching:
        process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL)
        os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
    try:
        yield
    finally:
        process.kill()
        process.wait()


@contextmanager
def _watching(url: str, seconds: float, phase: Phase) -> Iterator[None]:
    """Run a client that notes every state from WARM_UP_S on; the end of the block waits for it."""
    command = [sys.executable, "-m", "benchmarks.watch_states", url, str(seconds), str(WARM_UP_S)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)
    time.sleep(CONNECT_S)
    yield
    seen = json.loads(process.communicate(timeout=seconds + TIMEOUT_S)[0])
    phase.ages_s += seen["ages_s"]
    phase.intervals_s += seen["intervals_s"]


def main() -> None:
    """Run the floods that the command line names."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.floods", description=main.__doc__)
    parser.add_argument("kinds", nargs="*", choices=[*FLOODS, []], metavar="KIND", help=", ".join(FLOODS))
    parser.add_argument("--seconds", type=float, default=SECONDS, help="length of each phase")
    options = parser.parse_args()
    run(options.seconds, tuple(options.kinds) or tuple(FLOODS))


if __name__ == "__main__":
    main()
