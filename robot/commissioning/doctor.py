"""Examination of an arm: findings with a remedy each, from registers and measured times. Nothing is written."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

from robot.calibration import Calibration
from robot.commissioning.scan import CycleTimes, ScanResult, ServoRegisters, explain_missing
from robot.description.servo_table import ServoSpec
from robot.faults import ADVICE, ServoAlert, advise
from robot.hardware.feetech.family import PHASE_MULTI_TURN, POSITION_MODE, Feetech, differences
from robot.hardware.feetech.registers import MODELS, Register
from robot.hardware.interface import status_names
from robot.hardware.servos.registers import RETURN_DELAY_UNIT_US
from robot.messages import GuardLimits

VOLTAGE_DROP_V = 0.4  # a drop along the chain of more than this, without load, is contact resistance

# A cycle has 10 ms; with the write (0.6 ms) and a retry in reserve the read may take half of it.
LONGEST_ROUND_TRIP_S = 0.005

# 2.0 ms are usual. Above this some timer in between waits, such as the latency timer of an FTDI chip.
USUAL_ROUND_TRIP_S = 0.0035

USUAL_LOST_SHARE = 0.01  # single packets get lost on a good arm; one in a hundred is a bad cable
USUAL_LATENESS_S = 0.004  # a loop that starts later than this in one of a hundred cycles makes motions rough
LOCKED = 1  # value of register LOCK


class Verdict(Enum):
    """Severity of a finding."""

    GOOD = "good"
    NOTE = "note"
    PROBLEM = "problem"
    OPEN = "open"  # not checked, or undecided


@dataclass(frozen=True)
class Finding:
    """Result of one check."""

    check: str
    verdict: Verdict
    says: str
    remedy: str = ""  # advice to the person at the arm; empty for none


def judge_scan(result: ScanResult, joints: Sequence[ServoSpec], calibration: Calibration | None) -> list[Finding]:
    servos = result.servos
    missing = "; ".join(explain_missing(result, joints))
    listed = f"servos {_list(sorted(result.ids))} answer"
    findings = [_judged("servos", missing, "See docs/troubleshooting.md, By symptom.", listed)]
    if servos:
        findings += [*_kind(servos), _voltage(servos), *_condition(servos), *_settings(servos)]
        findings.append(_calibration(servos, calibration))
    return findings


def judge_cycles(times: CycleTimes) -> list[Finding]:
    lost = f"{times.lost_replies} of {times.expected_replies} replies lost"
    late = f"cycles start at most {times.lateness_p99_s * 1e3:.2f} ms late (p99)"
    many_lost = times.lost_replies > USUAL_LOST_SHARE * times.expected_replies
    remedy = "Leave the machine less to do, or allow real-time priority (docs/hardware.md)."
    return [
        _round_trip(times),
        _judged("lost replies", lost if many_lost else "", ADVICE[ServoAlert.SILENT_CYCLES].remedy(), lost),
        _judged("jitter", late if times.lateness_p99_s > USUAL_LATENESS_S else "", remedy, late, Verdict.NOTE),
    ]


def judge_long_reads(address: int, length: int, silent_ids: Sequence[int]) -> Finding:
    """Judge the replies to reads past the documented registers, whose lengths distinguish replies."""
    block = f"registers {address} to {address + length - 1}"
    return _judged(
        "long reads",
        f"servos {_list(silent_ids)} do not answer a read of {block}" if silent_ids else "",
        "Report their firmware: the driver asks for bytes past register 70 so that a late reply is recognised.",
        f"all servos answer a read of {block}",
    )


def _judged(check: str, wrong: str, remedy: str, sound: str, verdict: Verdict = Verdict.PROBLEM) -> Finding:
    return Finding(check, verdict, wrong, remedy) if wrong else Finding(check, Verdict.GOOD, sound)


def _kind(servos: Sequence[ServoRegisters]) -> Iterator[Finding]:
    wrong = [
        f"servo {servo.servo_id} is model {servo[Register.MODEL_NUMBER]} in mode {servo[Register.OPERATING_MODE]}"
        for servo in servos
        if servo[Register.MODEL_NUMBER] not in MODELS.values() or servo[Register.OPERATING_MODE] != POSITION_MODE
    ]
    known = " and ".join(f"{name.upper()} ({number})" for name, number in MODELS.items())
    remedy = (
        f"The driver takes {known} in position mode ({POSITION_MODE}): armbridge setup --registers sets the mode; "
        'name a clone in robot.toml, model = "NUMBER".'
    )
    yield _judged("model and mode", "; ".join(wrong), remedy, "all are known models in position mode")
    listed = ", ".join(f"{servo.servo_id}: {servo.firmware}" for servo in servos)
    differ = f"versions differ ({listed})" if len({servo.firmware for servo in servos}) > 1 else ""
    remedy = "Bring all to the same version with Feetech's FD program; lerobot refuses a mixture."
    yield _judged("firmware", differ, remedy, f"all have {servos[0].firmware}", Verdict.NOTE)


def _voltage(servos: Sequence[ServoRegisters]) -> Finding:
    lowest, highest = min(servo.voltage_v for servo in servos), max(servo.voltage_v for servo in servos)
    says = f"{lowest:.1f} to {highest:.1f} V"
    too_high = [servo.servo_id for servo in servos if servo.voltage_v > servo.voltage_limits_v[1]]
    if too_high:
        remedy = "Switch it off: this is a 7.4 V servo on a 12 V supply, or register 14 (Max_Voltage) is set wrongly."
        return Finding("voltage", Verdict.PROBLEM, f"{says}, too much for servos {_list(too_high)}", remedy)
    if lowest < GuardLimits.min_voltage_v:
        return Finding("voltage", Verdict.PROBLEM, says, "Use a supply of 5 V and 4 A or more, with short thick leads.")
    along = f"{says} along the chain" if highest - lowest > VOLTAGE_DROP_V else ""
    return _judged("voltage", along, "Look for a plug with bad contact.", says, Verdict.NOTE)


def _condition(servos: Sequence[ServoRegisters]) -> Iterator[Finding]:
    hottest = max(servos, key=lambda servo: servo[Register.PRESENT_TEMPERATURE])
    degrees = hottest[Register.PRESENT_TEMPERATURE]
    says = f"the hottest is servo {hottest.servo_id} with {degrees} degrees"
    verdict = Verdict.PROBLEM if degrees >= GuardLimits.stop_temperature_c else Verdict.NOTE
    warm = says if degrees >= GuardLimits.warn_temperature_c else ""
    remedy = "Let the arm cool without torque (armbridge relax); do not hold it stretched out."
    yield _judged("temperature", warm, remedy, says, verdict)
    flags = {servo.servo_id: status_names(servo[Register.STATUS]) for servo in servos if servo[Register.STATUS]}
    wrong = "; ".join(f"servo {servo_id}: {', '.join(names)}" for servo_id, names in flags.items())
    remedy = " ".join(advise(ServoAlert(name) for names in flags.values() for name in names))
    yield _judged("error bits", wrong, remedy, "no servo complains")


def _settings(servos: Sequence[ServoRegisters]) -> Iterator[Finding]:
    counting = [servo.servo_id for servo in servos if servo[Register.PHASE] & PHASE_MULTI_TURN]
    wrong = f"servos {_list(counting)} count several turns, so their position may overflow" if counting else ""
    yield _judged("phase bit 4", wrong, ADVICE[ServoAlert.SEVERAL_TURNS].remedy(), "positions stay within one turn")
    delayed = {servo.servo_id: servo[Register.RETURN_DELAY] for servo in servos if servo[Register.RETURN_DELAY]}
    says = ", ".join(f"servo {servo_id}: {delay * RETURN_DELAY_UNIT_US} us" for servo_id, delay in delayed.items())
    remedy = "armbridge setup --registers sets register RETURN_DELAY to 0; lerobot does so when it connects."
    yield _judged("return delay", says, remedy, "0", Verdict.NOTE)
    unlocked = [servo.servo_id for servo in servos if servo[Register.LOCK] != LOCKED]
    says = f"servos {_list(unlocked)} are unlocked, as lerobot leaves them: a value written by mistake stays"
    remedy = "It does no harm by itself; armbridge setup --registers locks the EPROM."
    yield _judged("EPROM lock", says if unlocked else "", remedy, "the EPROM is locked", Verdict.NOTE)


def _calibration(servos: Sequence[ServoRegisters], calibration: Calibration | None) -> Finding:
    if calibration is None:
        return Finding("calibration", Verdict.OPEN, "not compared", "Name it: --calibration NAME_OR_PATH.")
    if found := differences(calibration, {servo.servo_id: servo.registers for servo in servos}):
        listed = ", ".join(
            f"{each.joint} {each.register.name} {each.in_servo} instead of {each.calibrated}" for each in found
        )
        remedy = f"Was another arm's file named? {Feetech.recalibrate_advice}."
        return Finding("calibration", Verdict.PROBLEM, f"the servos hold {listed}", remedy)
    warnings = "; ".join(calibration.warnings())
    return _judged("calibration", warnings, "Calibrate again.", "the servos hold what the file says", Verdict.NOTE)


def _round_trip(times: CycleTimes) -> Finding:
    says = f"p50 {times.round_trip_p50_s * 1e3:.2f} ms, p99 {times.round_trip_p99_s * 1e3:.2f} ms"
    if not times.round_trip_p99_s <= LONGEST_ROUND_TRIP_S:
        remedy = "Connect the adapter to the machine itself, without hub or network; see docs/hardware.md."
        return Finding("round trip", Verdict.PROBLEM, says, remedy)
    slow = says if times.round_trip_p50_s > USUAL_ROUND_TRIP_S else ""
    remedy = "Set the adapter's latency timer to 1 ms; see return delay."
    return _judged("round trip", slow, remedy, says, Verdict.NOTE)


def _list(numbers: Sequence[int]) -> str:
    return ", ".join(str(number) for number in numbers)
