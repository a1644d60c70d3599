"""Measuring the bus: how long a cycle's read takes, and how punctual this machine is."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robot.control.pacing import PERIOD_S
from robot.servos.bus import Bus
from robot.servos.registers import TELEMETRY_ADDRESS, TELEMETRY_BYTES


@dataclass(frozen=True)
class CycleTimes:
    """Times of many read cycles.

    Attributes:
        cycles: how many.
        round_trip_p50_s: from the question to the last reply, median of the complete cycles [s]; NaN without one.
        round_trip_p99_s: its 99th percentile [s].
        lateness_p99_s: how late cycles began, 99th percentile [s].
        lost_replies: replies that were expected and did not come soundly.
        expected_replies: as many as should have come.
    """

    cycles: int
    round_trip_p50_s: float
    round_trip_p99_s: float
    lateness_p99_s: float
    lost_replies: int
    expected_replies: int


def measure_cycles(bus: Bus, servo_ids: Sequence[int], cycles: int) -> CycleTimes:
    """Read all servos at the rate of the servo loop and as it does.

    Args:
        bus: an open bus.
        servo_ids: those that are there.
        cycles: how many, 100 a second.

    Raises:
        PortLost: the port is gone.
    """
    round_trips, lateness = [], []
    replies = 0
    due_s = time.monotonic()
    for _ in range(cycles):
        due_s = max(due_s + PERIOD_S, time.monotonic())
        time.sleep(max(0.0, due_s - time.monotonic()))
        start_s = time.monotonic()
        frames = bus.sync_read(servo_ids, TELEMETRY_ADDRESS, TELEMETRY_BYTES)
        lateness.append(start_s - due_s)
        replies += len(frames)
        if len(frames) == len(servo_ids):
            round_trips.append(time.monotonic() - start_s)
    p50_s, p99_s = np.percentile(round_trips or [np.nan], [50, 99]).tolist()
    expected = cycles * len(servo_ids)
    return CycleTimes(cycles, p50_s, p99_s, float(np.percentile(lateness, 99)), expected - replies, expected)


def measure_reads(bus: Bus, servo_id: int, address: int, length: int, count: int) -> list[float]:
    """Times that sound replies of one servo took [s], sorted; fewer than ``count`` where replies were lost.

    Raises:
        PortLost: the port is gone.
    """
    taken = []
    for _ in range(count):
        start_s = time.monotonic()
        if servo_id in bus.sync_read((servo_id,), address, length):
            taken.append(time.monotonic() - start_s)
    return sorted(taken)
