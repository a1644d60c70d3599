"""Files about faults: what came before each, for a person who looks for its cause, or reports it.

A file has a JSON object a line: the fault, the last report of the arm's health, the last minute of the log, and the
last states of the joints.
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
from server.disk import Disk
from server.monitoring.log_ring import LogRing
from server.named_files import FileSeries

log = logging.getLogger("armbridge.monitoring")

PREFIX = "fault-"

WINDOW_S = 60.0

# They come 100 times a second at most, and take some 300 kB of a file.
MAX_STATES = 1000
QUANTITIES = ("position_rad", "goal_rad", "load", "current_a")

# A client that causes and resets faults without end must not wear out a memory card; the next file logs this fault.
LEAST_INTERVAL_S = 10.0


class FaultFiles:
    """Writes a file about each fault and each loss of the arm; ``keep`` 0 writes none."""

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
        self._disk = Disk()
        self._log_ring = log_ring
        self._robot_name = robot_name
        self._clock = clock
        self._state: ArmState | None = None
        # Time of the arm [s], and the quantities, shape (quantities, joints).
        self._samples: deque[tuple[float, NDArray[np.float64]]] = deque(maxlen=MAX_STATES)
        self._health: ArmHealth | None = None
        self._written_s = -math.inf
        self._writing: set[asyncio.Task[None]] = set()
        self.latest: Path | None = None

    def take_health(self, health: ArmHealth) -> None:
        self._health = health

    def take_state(self, state: ArmState) -> None:
        """Keep a state, and begin to write a file when it has a new fault."""
        if self._files is None:
            return
        before, self._state = self._state, state
        if state.position_rad is not None:
            # As of the goals of an arm that is relaxed.
            unknown = np.full(len(state.joint_names), np.nan)
            figures = [unknown if (each := getattr(state, name)) is None else each for name in QUANTITIES]
            self._samples.append((state.clock_s, np.array(figures)))
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
        lines, samples, end_s = [*self._lines(about, state)], tuple(self._samples), state.clock_s

        # In a thread, as it takes some milliseconds.
        def content() -> bytes:
            options = orjson.OPT_APPEND_NEWLINE | orjson.OPT_NON_STR_KEYS | orjson.OPT_SERIALIZE_NUMPY
            # NaN and infinity become null. Named tuples, as of a warning, become lists by ``default``.
            states = (
                {"kind": "state", "time_s": round(at_s - end_s, 3), **dict(zip(QUANTITIES, rows.round(4), strict=True))}
                for at_s, rows in samples
                # The clock of an arm process that was started again may be behind.
                if 0.0 <= end_s - at_s <= WINDOW_S
            )
            return b"".join(orjson.dumps(line, default=list, option=options) for line in (*lines, *states))

        try:
            self.latest = await self._disk.do(lambda: series.add(name, content))
        except OSError as error:
            log.warning("the file about this fault cannot be written to %s: %s", self._directory, error)
        else:
            log.info("the last minute before the fault is in %s, which armbridge report includes", self.latest)

    def _lines(self, about: dict[str, str], state: ArmState) -> Iterator[dict[str, Any]]:
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
