import math

import pytest

from robot.commissioning.scan import ScanResult, explain_missing, measure_cycles, measure_reads, scan
from robot.hardware.feetech.bus import status_bytes
from robot.hardware.feetech.registers import Register
from robot.hardware.port import wire_time_s
from tests.helpers.robots import SO101_SERVOS

IDS = (1, 2, 3, 4, 5, 6)


def found(*ids, garbled_bytes=0):
    return ScanResult((), ids, garbled_bytes)


def explained(*ids):
    return " ".join(explain_missing(found(*ids), SO101_SERVOS)[:1])


def test_a_scan_lists_every_servo_with_what_it_measures(bus):
    result = scan(bus, IDS)
    assert [servo.servo_id for servo in result.servos] == list(IDS)
    assert {(servo[Register.MODEL_NUMBER], servo.firmware) for servo in result.servos} == {(777, "3.10")}
    assert {(servo[Register.OPERATING_MODE], servo[Register.TORQUE_ENABLE]) for servo in result.servos} == {(0, 0)}
    assert all(servo.voltage_v == pytest.approx(5.0) for servo in result.servos)
    assert (result.unsteady_ids, result.garbled_bytes) == ((), 0)
    assert explain_missing(result, SO101_SERVOS) == []


def test_a_scan_finds_everybody_though_replies_get_lost(bus, emulator):
    emulator.command(drop=0.1)
    assert sorted(scan(bus, IDS).ids) == list(IDS)


def test_the_cause_is_looked_for_where_the_silence_begins():
    assert "power supply" in explained()
    assert "set the servos' ids" in explained(1)
    assert "cable that leads to it" in explained(1, 2, 3)
    assert "from wrist_flex on" in explained(1, 2, 3)
    assert "its id or baud rate" in explained(1, 2, 3, 4, 6)
    said = explain_missing(found(1, 2, 4, 5, 6, garbled_bytes=6), SO101_SERVOS)
    assert any("same id" in sentence for sentence in said)


@pytest.mark.parametrize("late_s", [0.0, 0.004])
def test_cycles_begin_at_the_rate_of_the_control_loop_and_a_late_machine_is_reported(bus, emulator, late_s):
    started_s = emulator.clock()
    times = measure_cycles(bus, IDS, 50, emulator.clock, lambda wait_s: emulator.run(wait_s + late_s))
    assert emulator.clock() - started_s == pytest.approx(0.5, abs=0.01)
    assert wire_time_s(status_bytes(15, 6), 1_000_000) <= times.round_trip_p50_s <= times.round_trip_p99_s
    assert (times.cycles, times.expected_replies) == (50, 300)
    assert times.lateness_p99_s == pytest.approx(late_s, abs=1e-6)


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
