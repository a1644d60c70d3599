"""Timing of the bus: round trips of the control loop's reads, and lateness of its cycles on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from robot.control.pacing import PERIOD_S
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import TELEMETRY_ADDRESS, TELEMETRY_BYTES


@dataclass(frozen=True)
class CycleTimes:
    """Times of many read cycles."""

    cycles: int
    # Time from the instruction to the last reply, median of the complete cycles [s]; NaN without one.
    round_trip_p50_s: float
    round_trip_p99_s: float  # its 99th percentile [s]
    lateness_p99_s: float  # start of the cycles after their deadlines, 99th percentile [s]
    lost_replies: int
    expected_replies: int


def measure_cycles(
    bus: Bus,
    servo_ids: Sequence[int],
    cycles: int,
    clock: Callable[[], float] = time.monotonic,
    wait: Callable[[float], None] = time.sleep,
) -> CycleTimes:
    """Read all servos as the control loop does, 100 times a second."""
    round_trips, lateness = [], []
    replies = 0
    due_s = clock()
    for _ in range(cycles):
        due_s = max(due_s + PERIOD_S, clock())
        wait(max(0.0, due_s - clock()))
        start_s = clock()
        frames = bus.sync_read(servo_ids, TELEMETRY_ADDRESS, TELEMETRY_BYTES)
        lateness.append(start_s - due_s)
        replies += len(frames)
        if len(frames) == len(servo_ids):
            round_trips.append(clock() - start_s)
    p50_s, p99_s = np.percentile(round_trips or [np.nan], [50, 99]).tolist()
    expected = cycles * len(servo_ids)
    return CycleTimes(cycles, p50_s, p99_s, float(np.percentile(lateness, 99)), expected - replies, expected)


def measure_reads(
    bus: Bus, servo_id: int, address: int, length: int, count: int, clock: Callable[[], float] = time.monotonic
) -> list[float]:
    """Measure round trips of reads of one servo; return the times of the valid replies, sorted [s]."""
    taken = []
    for _ in range(count):
        start_s = clock()
        if servo_id in bus.sync_read((servo_id,), address, length):
            taken.append(clock() - start_s)
    return sorted(taken)
