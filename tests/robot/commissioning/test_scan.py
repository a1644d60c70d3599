"""A scan of the servos, and the findings of the doctor."""

import math
from dataclasses import replace

import pytest

from harness.server import ROOT
from robot.commissioning.doctor import Verdict, judge_cycles, judge_long_reads, judge_scan
from robot.commissioning.scan import (
    CycleTimes,
    ScanResult,
    ServoRegisters,
    explain_missing,
    measure_cycles,
    scan,
)
from robot.hardware.feetech.bus import status_bytes
from robot.hardware.feetech.registers import Register
from robot.hardware.port import wire_time_s
from tests.helpers.robots import SO101_SERVOS, nominal_calibration

IDS = (1, 2, 3, 4, 5, 6)


def found(*ids, garbled_bytes=0):
    return ScanResult((), ids, garbled_bytes)


def explained(*ids):
    return " ".join(explain_missing(found(*ids), SO101_SERVOS)[:1])


def test_a_scan_lists_every_servo_with_what_it_measures_though_replies_get_lost(bus, emulator):
    result = scan(bus, IDS)
    assert [servo.servo_id for servo in result.servos] == list(IDS)
    assert {(servo[Register.MODEL_NUMBER], servo.firmware) for servo in result.servos} == {(777, "3.10")}
    assert {(servo[Register.OPERATING_MODE], servo[Register.TORQUE_ENABLE]) for servo in result.servos} == {(0, 0)}
    assert all(servo.voltage_v == pytest.approx(5.0) for servo in result.servos)
    assert (result.unsteady_ids, result.garbled_bytes) == ((), 0)
    assert explain_missing(result, SO101_SERVOS) == []
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
    emulator.command(offline=[3])
    times = measure_cycles(bus, IDS, 10, emulator.clock, emulator.run)
    assert times.lost_replies >= 10
    assert math.isnan(times.round_trip_p50_s)


NOMINAL = nominal_calibration()
SOUND = {
    Register.MODEL_NUMBER: 777,
    Register.FIRMWARE_MAJOR: 3,
    Register.FIRMWARE_MINOR: 10,
    Register.OPERATING_MODE: 0,
    Register.PHASE: 12,
    Register.RETURN_DELAY: 0,
    Register.MIN_VOLTAGE: 40,
    Register.MAX_VOLTAGE: 80,
    Register.PRESENT_VOLTAGE: 50,
    Register.PRESENT_TEMPERATURE: 32,
    Register.STATUS: 0,
    Register.LOCK: 1,
}
SETUP, CALIBRATE = "armbridge setup --registers", "armbridge calibrate NAME --write-back"
DOCS = "".join((ROOT / f"docs/{page}.md").read_text() for page in ("troubleshooting", "arm"))
TIMES = CycleTimes(300, 0.002, 0.0021, 0.0003, 0, 1800)


def report(spec, changes=()):
    joint = next(joint for joint in NOMINAL.joints if joint.joint == spec.joint)
    calibrated = {
        Register.MIN_ANGLE_LIMIT: joint.range_min,
        Register.MAX_ANGLE_LIMIT: joint.range_max,
        Register.HOMING_OFFSET: joint.homing_offset,
    }
    return ServoRegisters(spec.servo_id, {**SOUND, **calibrated, **dict(changes)})


def findings(changes=()):
    """The findings about an arm whose third servo is not as it should be, by check."""
    servos = tuple(report(spec, changes if spec.servo_id == 3 else ()) for spec in SO101_SERVOS)
    return {finding.check: finding for finding in judge_scan(ScanResult(servos), SO101_SERVOS, NOMINAL)}


@pytest.mark.parametrize(
    ("changes", "check", "verdict", "words", "command"),
    [
        ({Register.MODEL_NUMBER: 1284}, "model and mode", Verdict.PROBLEM, "servo 3 is model 1284", ""),
        ({Register.OPERATING_MODE: 3}, "model and mode", Verdict.PROBLEM, "in mode 3", SETUP),
        ({Register.FIRMWARE_MINOR: 9}, "firmware", Verdict.NOTE, "3: 3.9", ""),
        ({Register.PRESENT_VOLTAGE: 42}, "voltage", Verdict.PROBLEM, "4.2 to 5.0 V", ""),
        ({Register.PRESENT_VOLTAGE: 121}, "voltage", Verdict.PROBLEM, "too much for servos 3", ""),
        ({Register.PRESENT_VOLTAGE: 45}, "voltage", Verdict.NOTE, "along the chain", ""),
        ({Register.PRESENT_TEMPERATURE: 56}, "temperature", Verdict.NOTE, "servo 3 with 56", ""),
        ({Register.PRESENT_TEMPERATURE: 66}, "temperature", Verdict.PROBLEM, "servo 3 with 66", ""),
        ({Register.STATUS: 33}, "error bits", Verdict.PROBLEM, "3: voltage, overload", ""),
        ({Register.PHASE: 28}, "phase bit 4", Verdict.PROBLEM, "servos 3 count", SETUP),
        ({Register.RETURN_DELAY: 250}, "return delay", Verdict.NOTE, "servo 3: 500 us", SETUP),
        ({Register.LOCK: 0}, "EPROM lock", Verdict.NOTE, "servos 3 are unlocked", SETUP),
        ({Register.HOMING_OFFSET: 5}, "calibration", Verdict.PROBLEM, "elbow_flex HOMING_OFFSET 5 instead", CALIBRATE),
    ],
)
def test_what_is_wrong_is_found_named_and_given_the_remedy_of_the_docs(changes, check, verdict, words, command):
    found = findings(changes)
    assert found[check].verdict is verdict
    assert words in found[check].says
    assert found[check].remedy
    assert command in found[check].remedy
    assert command in DOCS
    assert {finding.verdict for name, finding in found.items() if name != check} == {Verdict.GOOD}


@pytest.mark.parametrize(
    ("changes", "check", "verdict"),
    [
        ({"round_trip_p99_s": 0.008}, "round trip", Verdict.PROBLEM),
        ({"round_trip_p99_s": float("nan")}, "round trip", Verdict.PROBLEM),
        ({"round_trip_p50_s": 0.004, "round_trip_p99_s": 0.0045}, "round trip", Verdict.NOTE),
        ({"lost_replies": 40}, "lost replies", Verdict.PROBLEM),
        ({"lateness_p99_s": 0.006}, "jitter", Verdict.NOTE),
    ],
)
def test_bad_times_and_servos_that_do_not_answer_long_reads_are_found(changes, check, verdict):
    found = {finding.check: finding for finding in judge_cycles(replace(TIMES, **changes))}
    assert found[check].verdict is verdict
    assert found[check].remedy
    assert {finding.verdict for name, finding in found.items() if name != check} == {Verdict.GOOD}
    assert judge_long_reads(56, 31, []).verdict is Verdict.GOOD
    bad = judge_long_reads(56, 31, [2, 5])
    assert bad.verdict is Verdict.PROBLEM
    assert "servos 2, 5 do not answer a read of registers 56 to 86" in bad.says


def test_a_missing_servo_is_a_problem_and_an_empty_bus_is_only_that_and_without_a_calibration_its_check_stays_open():
    (found,) = judge_scan(ScanResult(()), SO101_SERVOS, None)
    assert found.verdict is Verdict.PROBLEM
    assert "power supply" in found.says
    servos = tuple(report(spec) for spec in SO101_SERVOS)
    assert judge_scan(ScanResult(servos), SO101_SERVOS, None)[-1].verdict is Verdict.OPEN
