from __future__ import annotations

import math

import pytest

from robot.commissioning.scan import measure_cycles, measure_reads
from robot.hardware.feetech.bus import status_bytes
from robot.hardware.port import wire_time_s

IDS = (1, 2, 3, 4, 5, 6)


def test_no_round_trip_is_shorter_than_the_wire_takes(bus, emulator):
    times = measure_cycles(bus, IDS, 20, emulator.clock, emulator.run)
    assert wire_time_s(status_bytes(15, 6), 1_000_000) <= times.round_trip_p50_s <= times.round_trip_p99_s
    assert (times.cycles, times.expected_replies) == (20, 120)
    assert times.lateness_p99_s >= 0.0


def test_cycles_begin_at_the_rate_of_the_control_loop(bus, emulator):
    started_s = emulator.clock()
    measure_cycles(bus, IDS, 50, emulator.clock, emulator.run)
    assert emulator.clock() - started_s == pytest.approx(0.5, abs=0.005)


def test_a_machine_that_wakes_late_is_reported(bus, emulator):
    times = measure_cycles(bus, IDS, 20, emulator.clock, lambda wait_s: emulator.run(wait_s + 0.004))
    assert times.lateness_p99_s == pytest.approx(0.004)


def test_every_lost_reply_is_counted(bus, emulator):
    emulator.command(offline=[2])
    times = measure_cycles(bus, IDS, 10, emulator.clock, emulator.run)
    assert times.lost_replies >= 10
    assert math.isnan(times.round_trip_p50_s)


def test_reads_of_one_servo_are_timed_shortest_first(bus, emulator):
    taken = measure_reads(bus, 3, 56, 15, 8, emulator.clock)
    assert taken == sorted(taken)
    assert wire_time_s(status_bytes(15), 1_000_000) < taken[0] <= taken[-1] < 0.005
    assert len(taken) > 4
    emulator.command(offline=[3])
    assert measure_reads(bus, 3, 56, 15, 2, emulator.clock) == []
