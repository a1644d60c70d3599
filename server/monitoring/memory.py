"""Memory of the server process: garbage collections that hold nothing up, and memory that is given back after a burst.

A collection holds the interpreter, and with it the event loop. Python's own full collections go through all objects
that are alive: with a million of them 140 to 240 ms each, and 34 of them for 20 planning scenes of 5000 objects.
"""

import asyncio
import contextlib
import ctypes
import gc
import logging
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

log = logging.getLogger("armbridge.monitoring")

# Threads take turns of this length: a thread that decodes a large message leaves the event loop waiting for one at each
# of its own. Python's default is 5 ms.
SWITCH_INTERVAL_S = 0.001

# A full collection follows upon four collections of the middle generation, each upon eleven of the youngest, each upon
# 700 objects: 30,000 objects, which take 5 ms (a million took 141 ms).
THRESHOLDS = (700, 10, 3)

# Objects that outlive a longer full collection are left out of later ones, so that each object is gone through once.
# With a million objects made one after the other, the longest collection took 16 ms instead of 190 ms.
FREEZE_ABOVE_S = 0.002

# Objects that were left out may have become garbage in cycles; a collection of all is made no more often than this.
FULL_COLLECTION_PERIOD_S = 600.0

CHECK_PERIOD_S = 1.0

# Least growth of the resident memory since the start that is worth a trim.
EXCESS_BYTES = 16 << 20

# A trim takes 0.2 ms a megabyte that it gives back, and until it is done nobody else gets memory.
TRIM_PERIOD_S = 60.0

# Memory that grows by more between two checks is in use.
SETTLED_BYTES = 4 << 20


class CollectorPolicy:
    """Policy of Python's garbage collector, by which no collection takes long.

    ``keeps_frozen`` is for a forked process: a collection of all would copy the memory that it shares with others.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter, *, keeps_frozen: bool = False) -> None:
        self._clock = clock
        self._keeps_frozen = keeps_frozen
        self._before: tuple[int, int, int] | None = None
        self._began_s = 0.0
        self.overdue = False  # true when objects were left out of collections since the last collection of all

    def start(self) -> None:
        """Collect, leave objects that live as long as the server out of later collections, and watch these."""
        self.collect_all()
        self._before = gc.get_threshold()
        gc.set_threshold(*THRESHOLDS)
        gc.callbacks.append(self._on_collection)

    def stop(self) -> None:
        if self._before is not None:
            gc.callbacks.remove(self._on_collection)
            gc.set_threshold(*self._before)
            self._before = None

    def collect_all(self) -> None:
        """Collect among all objects, those that were left out as well, and leave out what remains."""
        if not self._keeps_frozen:
            gc.unfreeze()
        gc.collect()
        gc.freeze()
        self.overdue = False

    def _on_collection(self, phase: str, info: dict[str, Any]) -> None:
        if info["generation"] < len(THRESHOLDS) - 1:
            return
        if phase == "start":
            self._began_s = self._clock()
        elif self._clock() - self._began_s > FREEZE_ABOVE_S:
            gc.freeze()
            self.overdue = True


def resident_bytes() -> int:
    """Return the resident memory of this process [bytes] (proc_pid_statm(5))."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def trim_heap() -> None:
    """Give free memory back to the system (malloc_trim(3)); without effect where the C library has no such call."""
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)


class MemoryKeeper:
    """Gives memory back while no motion could be delayed by a pause.

    The C library keeps the memory of a burst of large messages, unless it happens to be the last of its heap.
    """

    def __init__(
        self,
        collector: CollectorPolicy,
        quiet: Callable[[], bool],
        read_bytes: Callable[[], int] = resident_bytes,
        trim: Callable[[], None] = trim_heap,
    ) -> None:
        self._collector = collector
        self._quiet = quiet
        self._read_bytes = read_bytes
        self._trim = trim
        self._lowest_bytes = sys.maxsize
        self._latest_bytes = 0
        self._next_trim_s = 0.0
        self._next_collection_s = 0.0

    async def run(self) -> None:
        # The collector's start has collected all.
        self._next_collection_s = time.monotonic() + FULL_COLLECTION_PERIOD_S
        while True:
            await asyncio.sleep(CHECK_PERIOD_S)
            await self.check(time.monotonic())

    async def check(self, now_s: float) -> None:
        resident = self._read_bytes()
        settled = resident <= self._latest_bytes + SETTLED_BYTES
        self._latest_bytes = resident
        self._lowest_bytes = min(self._lowest_bytes, resident)
        if not settled or not self._quiet():
            return
        if self._collector.overdue and now_s >= self._next_collection_s:
            self._next_collection_s = now_s + FULL_COLLECTION_PERIOD_S
            self._collector.collect_all()
        if resident - self._lowest_bytes >= EXCESS_BYTES and now_s >= self._next_trim_s:
            self._next_trim_s = now_s + TRIM_PERIOD_S
            await asyncio.to_thread(self._trim)
            self._latest_bytes = self._read_bytes()
            log.debug("%.0f MB of memory given back", (resident - self._latest_bytes) / 1e6)
