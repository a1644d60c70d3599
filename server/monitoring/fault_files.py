"""Files about faults: the last minute before each, for a person who looks for its cause, or reports it.

A file has a JSON object a line: the fault, the last report of the arm's health, the lines of the log, and the states of
the joints.
"""

import asyncio
import dataclasses
import logging
import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from robot.messages import ArmHealth, ArmState, Mode
from server.monitoring.log_ring import LogRing
from server.named_files import FileSeries

log = logging.getLogger("armbridge.monitoring")

PREFIX = "fault-"

WINDOW_S = 60.0

# The minute at this rate, and its last seconds at the rate of the states, which come 100 times a second at most.
SLOW_PERIOD_S = 0.1
SLOW_SAMPLES = round(WINDOW_S / SLOW_PERIOD_S)
FAST_SAMPLES = 500

# A client that causes and resets faults without end must not wear out a memory card; the next file logs this fault.
LEAST_INTERVAL_S = 10.0

# A disk that takes longer keeps the file to itself.
WRITING_TIMEOUT_S = 5.0

# Arrays of a state that are kept.
_QUANTITIES = ("position_rad", "goal_rad", "load", "current_a")


# Time [s], and the quantities of all joints, shape (quantities, joints).
Sample = tuple[float, NDArray[np.float64]]


class StateTrace:
    """States of the joints over the last minute, the last seconds of them more closely."""

    def __init__(self) -> None:
        self._names: tuple[str, ...] = ()
        self._slow: deque[Sample] = deque(maxlen=SLOW_SAMPLES)
        self._fast: deque[Sample] = deque(maxlen=FAST_SAMPLES)

    def add(self, state: ArmState) -> None:
        """Keep a state; one without positions has nothing to keep."""
        arrays = (state.position_rad, state.goal_rad, state.load, state.current_a)
        if len(present := [array for array in arrays if array is not None]) < len(arrays):
            return
        if state.joint_names != self._names:
            self._names = state.joint_names
            self._slow.clear()
            self._fast.clear()
        sample = state.clock_s, np.array(present)
        self._fast.append(sample)
        # The clock of a process that has started again may be behind.
        if not self._slow or not 0.0 <= state.clock_s - self._slow[-1][0] < SLOW_PERIOD_S:
            self._slow.append(sample)

    def minute(self, end_s: float) -> list[Sample]:
        """Return the samples of the minute before a time of the arm's clock [s], oldest first, with the time to it."""
        fast = [sample for sample in self._fast if sample[0] >= end_s - WINDOW_S]
        fast_from_s = fast[0][0] if fast else math.inf
        slow = [sample for sample in self._slow if end_s - WINDOW_S <= sample[0] < fast_from_s]
        return [(at_s - end_s, values) for at_s, values in slow + fast]


class FaultFiles:
    """Writes a file of some 300 kB about each fault and each loss of the arm; ``keep`` 0 writes none."""

    def __init__(
        self,
        directory: Path,
        keep: int,
        log_ring: LogRing,
        robot_name: str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._files = FileSeries(directory, PREFIX, ".jsonl", keep) if keep else None
        self._directory = directory
        self._log_ring = log_ring
        self._robot_name = robot_name
        self._clock = clock
        self._trace = StateTrace()
        self._state: ArmState | None = None
        self._health: ArmHealth | None = None
        self._written_s = -np.inf
        self._writing: set[asyncio.Task[None]] = set()
        self.latest: Path | None = None

    def take_health(self, health: ArmHealth) -> None:
        self._health = health

    def take_state(self, state: ArmState) -> None:
        """Keep a state; begin to write a file when it has a new fault."""
        if self._files is None:
            return
        before, self._state = self._state, state
        self._trace.add(state)
        fault = state.fault
        if fault is not None and (before is None or fault != before.fault):
            about = {"code": fault.code.value, "message": fault.message, "remedy": fault.remedy, "joint": fault.joint}
        elif before is not None and state.mode is Mode.DISCONNECTED is not before.mode:
            about = {"code": "disconnected", "message": state.reason, "remedy": "", "joint": ""}
        else:
            return
        now_s = self._clock()
        if now_s - self._written_s < LEAST_INTERVAL_S:
            log.info("no file about this fault: the last one is %.0f s old", now_s - self._written_s)
            return
        self._written_s = now_s
        task = asyncio.create_task(self._write(self._files, about, state), name="fault file")
        self._writing.add(task)
        task.add_done_callback(self._writing.discard)

    async def close(self) -> None:
        """Wait until the files that were begun are written."""
        if self._writing:
            await asyncio.wait(self._writing)

    async def _write(self, series: FileSeries, about: dict[str, str], state: ArmState) -> None:
        now = datetime.fromtimestamp(state.stamp_s, UTC)
        name = f"{now:%Y%m%dT%H%M%S.%fZ}-{about['code']}"
        head, samples = [*self._head(about, state)], self._trace.minute(state.clock_s)

        # In a thread, as it takes some milliseconds.
        def content() -> bytes:
            # A number that is none, or infinite, is null.
            options = orjson.OPT_APPEND_NEWLINE | orjson.OPT_NON_STR_KEYS | orjson.OPT_SERIALIZE_NUMPY
            return b"".join(orjson.dumps(line, option=options) for line in (*head, *map(_state_line, samples)))

        try:
            self.latest = await asyncio.wait_for(asyncio.to_thread(series.add, name, content), WRITING_TIMEOUT_S)
        except TimeoutError:
            log.warning("the file about this fault is not written to %s in %g s", self._directory, WRITING_TIMEOUT_S)
        except OSError as error:
            log.warning("the file about this fault cannot be written to %s: %s", self._directory, error)
        else:
            log.info("the last minute before the fault is in %s; armbridge report takes it along", self.latest)

    def _head(self, about: dict[str, str], state: ArmState) -> Iterator[dict[str, Any]]:
        time_text = datetime.fromtimestamp(state.stamp_s, UTC).isoformat(timespec="milliseconds")
        yield {
            "kind": "fault",
            **about,
            "time": time_text,
            "mode": state.mode.value,
            "robot": self._robot_name,
            "armbridge": metadata.version("armbridge"),
            "joints": state.joint_names,
        }
        if self._health is not None:
            yield {"kind": "health", **dataclasses.asdict(self._health)}
        now_s = self._clock()
        for line in self._log_ring.since(now_s - WINDOW_S):
            fields = {"time_s": round(line.monotonic_s - now_s, 3), "level": logging.getLevelName(line.level)}
            yield {"kind": "log", **fields, "process": line.process, "logger": line.logger, "text": line.text}


def _state_line(sample: Sample) -> dict[str, Any]:
    at_s, values = sample
    quantities = zip(_QUANTITIES, values.round(4).tolist(), strict=True)
    return {"kind": "state", "time_s": round(at_s, 3), **dict(quantities)}
