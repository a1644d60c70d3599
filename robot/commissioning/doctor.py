"""Diagnosis of an arm from its registers and measured times: one finding with a remedy for each check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from robot.calibration import SO101_JOINTS, Calibration
from robot.commissioning.calibrate import differences
from robot.commissioning.scan import ScanResult, ServoReport, explain_missing
from robot.commissioning.timing import CycleTimes
from robot.hardware.feetech.registers import MODEL_STS3215
from robot.hardware.feetech.survey import PHASE_MULTI_TURN, POSITION_MODE
from robot.hardware.interface import status_names

# Temperatures of the motor's housing [degC] at which the arm process, by default, stops the arm and warns.
HOT_C = 65
WARM_C = 55

# Below this an STS3215 loses torque and reboots under load; the usual supply gives 5 V.
LOW_VOLTAGE_V = 4.5

# A drop along the chain of more than this, without load, is contact resistance.
VOLTAGE_DROP_V = 0.4

# A cycle has 10 ms; with the write (0.6 ms) and a retry in reserve the read may take half of it.
LONGEST_ROUND_TRIP_S = 0.005

# 2.0 ms are usual. Above this some timer in between waits, such as the latency timer of an FTDI chip.
USUAL_ROUND_TRIP_S = 0.0035

# Single packets get lost on a good arm; one in a hundred is a bad cable.
USUAL_LOST_SHARE = 0.01

# A loop that starts later than this in one of a hundred cycles makes motions rough.
USUAL_LATENESS_S = 0.004

# Unit of register RETURN_DELAY [us].
RETURN_DELAY_US = 2


class Verdict(Enum):
    """Severity of a finding."""

    GOOD = "good"
    NOTE = "note"
    PROBLEM = "problem"
    OPEN = "open"  # not checked, or undecided


@dataclass(frozen=True)
class Finding:
    """Result of one check.

    Attributes:
        check: name of the check.
        verdict: severity.
        says: observation, a sentence or figures.
        remedy: advice to the person at the arm; empty for none.
    """

    check: str
    verdict: Verdict
    says: str
    remedy: str = ""


def judge_scan(result: ScanResult, calibration: Calibration | None) -> list[Finding]:
    """Judge the result of a scan.

    Args:
        result: result of the scan.
        calibration: calibration of the arm; None if it is not known.
    """
    findings = [_servos(result)]
    if result.servos:
        servos = result.servos
        findings += [
            _kind(servos),
            _firmware(servos),
            _voltage(servos),
            _temperature(servos),
            _status(servos),
            _phase(servos),
            _return_delay(servos),
            _calibration(servos, calibration),
        ]
    return findings


def judge_cycles(times: CycleTimes) -> list[Finding]:
    """Judge the timing of bus and machine."""
    return [_round_trip(times), _losses(times), _punctuality(times)]


def judge_long_reads(address: int, length: int, silent_ids: Sequence[int]) -> Finding:
    """Judge the replies to reads past the documented registers, whose lengths distinguish replies.

    Args:
        address: first register of the read.
        length: bytes of the read.
        silent_ids: servos that did not reply to it.
    """
    block = f"registers {address} to {address + length - 1}"
    if not silent_ids:
        return Finding("long reads", Verdict.GOOD, f"all servos answer a read of {block}")
    return Finding(
        "long reads",
        Verdict.PROBLEM,
        f"servos {_list(silent_ids)} do not answer a read of {block}",
        "Report their firmware: the driver asks for bytes past register 70 so that a late reply is recognised.",
    )


def _servos(result: ScanResult) -> Finding:
    problems = explain_missing(result, SO101_JOINTS)
    if problems:
        return Finding("servos", Verdict.PROBLEM, "; ".join(problems), "See docs/hardware.md, By symptom.")
    return Finding("servos", Verdict.GOOD, f"servos {_list(sorted(result.ids))} answer")


def _kind(servos: Sequence[ServoReport]) -> Finding:
    wrong = [
        f"servo {servo.servo_id} is model {servo.model} in mode {servo.mode}"
        for servo in servos
        if (servo.model, servo.mode) != (MODEL_STS3215, POSITION_MODE)
    ]
    if wrong:
        remedy = "The driver takes STS3215 (model 777) in position mode (0) only: set register 33 to 0, or replace it."
        return Finding("model and mode", Verdict.PROBLEM, "; ".join(wrong), remedy)
    return Finding("model and mode", Verdict.GOOD, "all are STS3215 in position mode")


def _firmware(servos: Sequence[ServoReport]) -> Finding:
    versions = {f"{servo.firmware[0]}.{servo.firmware[1]}" for servo in servos}
    if len(versions) > 1:
        listed = ", ".join(f"{servo.servo_id}: {servo.firmware[0]}.{servo.firmware[1]}" for servo in servos)
        remedy = "Bring all to the same version with Feetech's FD program; lerobot refuses a mixture."
        return Finding("firmware", Verdict.NOTE, f"versions differ ({listed})", remedy)
    return Finding("firmware", Verdict.GOOD, f"all have {versions.pop()}")


def _voltage(servos: Sequence[ServoReport]) -> Finding:
    volts = {servo.servo_id: servo.telemetry.voltage_v for servo in servos}
    lowest, highest = min(volts.values()), max(volts.values())
    says = f"{lowest:.1f} to {highest:.1f} V"
    too_high = [servo.servo_id for servo in servos if volts[servo.servo_id] > servo.max_voltage_v]
    if too_high:
        remedy = "Switch it off: this is a 7.4 V servo on a 12 V supply, or register 14 (Max_Voltage) is set wrongly."
        return Finding("voltage", Verdict.PROBLEM, f"{says}, too much for servos {_list(too_high)}", remedy)
    if lowest < LOW_VOLTAGE_V:
        return Finding("voltage", Verdict.PROBLEM, says, "Use a supply of 5 V and 4 A or more, with short thick leads.")
    if highest - lowest > VOLTAGE_DROP_V:
        return Finding("voltage", Verdict.NOTE, f"{says} along the chain", "Look for a plug with bad contact.")
    return Finding("voltage", Verdict.GOOD, says)


def _temperature(servos: Sequence[ServoReport]) -> Finding:
    hottest = max(servos, key=lambda servo: servo.telemetry.temperature_c)
    degrees = hottest.telemetry.temperature_c
    says = f"the hottest is servo {hottest.servo_id} with {degrees} degrees"
    if degrees >= WARM_C:
        verdict = Verdict.PROBLEM if degrees >= HOT_C else Verdict.NOTE
        return Finding("temperature", verdict, says, "Relax the arm and let it cool; do not hold it stretched out.")
    return Finding("temperature", Verdict.GOOD, says)


def _status(servos: Sequence[ServoReport]) -> Finding:
    problems = [
        f"servo {servo.servo_id}: {', '.join(status_names(servo.telemetry.status))}"
        for servo in servos
        if servo.telemetry.status
    ]
    if problems:
        remedy = "Relieve the joint and reset the fault; if it stays, switch the servos' supply off and on."
        return Finding("error bits", Verdict.PROBLEM, "; ".join(problems), remedy)
    return Finding("error bits", Verdict.GOOD, "no servo complains")


def _phase(servos: Sequence[ServoReport]) -> Finding:
    counting = [servo.servo_id for servo in servos if servo.phase & PHASE_MULTI_TURN]
    if counting:
        remedy = "Clear bit 4 (value 16) of register 18 with Feetech's FD program, or connect lerobot once: it does."
        says = f"servos {_list(counting)} count several turns, so their position may overflow"
        return Finding("phase bit 4", Verdict.PROBLEM, says, remedy)
    return Finding("phase bit 4", Verdict.GOOD, "positions stay within one turn")


def _return_delay(servos: Sequence[ServoReport]) -> Finding:
    delayed = {servo.servo_id: servo.return_delay * RETURN_DELAY_US for servo in servos if servo.return_delay}
    if delayed:
        says = ", ".join(f"servo {servo_id}: {delay} us" for servo_id, delay in delayed.items())
        remedy = "If the round trip is long, set register 7 (Return_Delay) to 0; lerobot does when it connects."
        return Finding("return delay", Verdict.NOTE, says, remedy)
    return Finding("return delay", Verdict.GOOD, "0")


def _calibration(servos: Sequence[ServoReport], calibration: Calibration | None) -> Finding:
    if calibration is None:
        return Finding("calibration", Verdict.OPEN, "not compared", "Name it: --calibration NAME_OR_PATH.")
    found = differences(calibration, servos)
    if found:
        listed = ", ".join(
            f"{each.joint} {each.register.name} {each.in_servo} instead of {each.calibrated}" for each in found
        )
        remedy = "Was another arm's file named? Else calibrate anew: armbridge calibrate --write-servos."
        return Finding("calibration", Verdict.PROBLEM, f"the servos hold {listed}", remedy)
    if warnings := calibration.warnings():
        return Finding("calibration", Verdict.NOTE, "; ".join(warnings), "Calibrate anew.")
    return Finding("calibration", Verdict.GOOD, "the servos hold what the file says")


def _round_trip(times: CycleTimes) -> Finding:
    says = f"p50 {times.round_trip_p50_s * 1e3:.2f} ms, p99 {times.round_trip_p99_s * 1e3:.2f} ms"
    if not times.round_trip_p99_s <= LONGEST_ROUND_TRIP_S:
        remedy = "Connect the adapter to the machine itself, without hub or network; see docs/hardware.md."
        return Finding("round trip", Verdict.PROBLEM, says, remedy)
    if times.round_trip_p50_s > USUAL_ROUND_TRIP_S:
        remedy = "Set the adapter's latency timer to 1 ms; set the servos' return delay (register 7) to 0."
        return Finding("round trip", Verdict.NOTE, says, remedy)
    return Finding("round trip", Verdict.GOOD, says)


def _losses(times: CycleTimes) -> Finding:
    says = f"{times.lost_replies} of {times.expected_replies} replies lost"
    if times.lost_replies > USUAL_LOST_SHARE * times.expected_replies:
        remedy = "Replace cables and plugs one by one; keep them away from the supply's leads."
        return Finding("lost replies", Verdict.PROBLEM, says, remedy)
    return Finding("lost replies", Verdict.GOOD, says)


def _punctuality(times: CycleTimes) -> Finding:
    says = f"cycles start at most {times.lateness_p99_s * 1e3:.2f} ms late (p99)"
    if times.lateness_p99_s > USUAL_LATENESS_S:
        remedy = "Leave the machine less to do, or allow real-time priority (docs/hardware.md)."
        return Finding("jitter", Verdict.NOTE, says, remedy)
    return Finding("jitter", Verdict.GOOD, says)


def _list(numbers: Sequence[int]) -> str:
    return ", ".join(str(number) for number in numbers)
