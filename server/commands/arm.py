"""Commands on a real arm: ``armbridge scan``, ``doctor``, ``relax`` and ``verify``."""

import argparse
import contextlib
import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, cast, get_args

from robot.calibration import Calibration
from robot.commissioning.doctor import Finding, Verdict, judge_cycles, judge_long_reads, judge_scan
from robot.commissioning.scan import BAUDRATES, ScanResult, ServoRegisters, explain_missing, measure_cycles, scan
from robot.description.servo_table import ServoKind, ServoSpec
from robot.errors import NoReply
from robot.hardware.boards import resolve_port
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.family import Feetech
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import run_to_end, status_names
from robot.hardware.servos.bus import ServoBus, read_registers
from robot.hardware.servos.family import Limit, ServoFamily, full_torque
from robot.hardware.servos.hardware import family_of
from robot.hardware.servos.torque import LOWER_S, relax, write_limits
from robot.messages import GuardLimits
from server.commands.options import (
    DEFAULT_URL,
    FEETECH_ONLY,
    WITH_TOKEN,
    Subparsers,
    add_arm,
    add_calibration,
    add_command,
    load_calibration,
    open_bus,
    read_hardware,
    signals_wait,
    token_from_environment,
    websocket_url,
)
from server.commands.terminal import ExitCode, Terminal, table

HEADINGS = (
    "id", "joint", "model", "firmware", "V", "degC", "mode", "position", "limits", "offset", "torque", "complaints",
)  # fmt: skip


def add_scan_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "scan",
        _scan,
        "list the servos on the bus, and say which are missing and why",
        "List every servo on the bus: id, model, firmware, supply voltage, temperature, operating mode, "
        "position, angle limits, homing offset [ticks], and whether torque is on. Only reads; nothing moves."
        + FEETECH_ONLY,
    )
    add_arm(parser)
    parser.add_argument("--all-bauds", action="store_true", help="look at every baud rate, not only at 1000000")


def _scan(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    servos, port = read_hardware(options).servos, resolve_port(options.serial)
    names = {servo.servo_id: servo.joint for servo in servos}
    complaints: list[str] = []
    for baudrate in BAUDRATES if options.all_bauds else BAUDRATES[:1]:
        terminal.err(f"scanning {port} at {baudrate} baud ...")
        with contextlib.closing(Bus.open(port, baudrate)) as bus:
            result = scan(bus, tuple(names))
        if result.servos:
            terminal.out(table(HEADINGS, [_row(servo, names) for servo in result.servos]))
        if baudrate == BAUDRATES[0]:
            complaints += explain_missing(result, servos)
        else:
            remedy = f"set it to {BAUDRATES[0]} (armbridge setup)"
            complaints += [f"servo {each} listens at {baudrate} baud: {remedy}" for each in sorted(result.ids)]
    for complaint in complaints:
        terminal.err(complaint)
    return ExitCode.PROBLEMS if complaints else ExitCode.DONE


def _row(servo: ServoRegisters, names: Mapping[int, str]) -> list[object]:
    lowest, highest = servo.angle_limits_ticks
    return [
        servo.servo_id,
        names.get(servo.servo_id, "?"),
        servo[Register.MODEL_NUMBER],
        servo.firmware,
        f"{servo.voltage_v:.1f}",
        servo[Register.PRESENT_TEMPERATURE],
        servo[Register.OPERATING_MODE],
        servo[Register.PRESENT_POSITION],
        f"{lowest}..{highest}",
        servo[Register.HOMING_OFFSET],
        "on" if servo[Register.TORQUE_ENABLE] else "off",
        ", ".join(status_names(servo[Register.STATUS])) or "-",
    ]


# Three seconds at 100 Hz: enough for a 99th percentile.
CYCLES = 300

# The highest register that the bus's reads of varying length ever ask for, and as many bytes as it asks at most.
LONG_READ_ADDRESS = 56
LONG_READ_BYTES = 31

LINE_WIDTH = 100


def add_doctor_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "doctor",
        _doctor,
        "measure the arm and its bus, judge them, and say what to do",
        "Look at every servo, measure the bus for a few seconds, and print a verdict per check with what "
        "to do. Nothing is written." + FEETECH_ONLY,
    )
    add_arm(parser)
    add_calibration(parser)
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")


def _doctor(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    hardware, name = read_hardware(options), options.calibration
    calibration = None if name is None else load_calibration(name, hardware)
    with contextlib.closing(open_bus(options)) as bus:
        _, findings = examine_bus(bus, hardware.servos, calibration, terminal)
    terminal.out(as_json(findings) if options.json else _as_text(findings))
    problems = any(finding.verdict is Verdict.PROBLEM for finding in findings)
    return ExitCode.PROBLEMS if problems else ExitCode.DONE


def examine_bus(
    bus: Bus, servos: Sequence[ServoSpec], calibration: Calibration | None, terminal: Terminal
) -> tuple[ScanResult, list[Finding]]:
    """Scan the bus, measure it and judge both; nothing is written."""
    terminal.err("looking at the servos ...")
    result = scan(bus, tuple(servo.servo_id for servo in servos))
    findings = judge_scan(result, servos, calibration)
    present = tuple(servo.servo_id for servo in result.servos)
    if present:
        terminal.err(f"measuring {CYCLES} cycles at 100 Hz ...")
        findings += judge_cycles(measure_cycles(bus, present, CYCLES))
        block = LONG_READ_ADDRESS, LONG_READ_BYTES
        attempts = range(5)  # a single reply may get lost
        silent = [servo for servo in present if not any(bus.sync_read((servo,), *block) for _ in attempts)]
        findings.append(judge_long_reads(*block, silent))
    return result, findings


def as_json(findings: list[Finding]) -> str:
    return json.dumps([asdict(finding) | {"verdict": finding.verdict.value} for finding in findings], indent=2)


def _as_text(findings: list[Finding]) -> str:
    rows = [(finding.verdict.value, finding.check, finding.says) for finding in findings]
    remedies = [
        textwrap.fill(f"{finding.check}: {finding.remedy}", LINE_WIDTH, initial_indent="* ", subsequent_indent="  ")
        for finding in findings
        if finding.remedy
    ]
    listed = ["", "What to do:", *remedies] if remedies else []
    return "\n".join([table(("verdict", "check", "found"), rows), *listed])


def add_relax_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "relax",
        _relax,
        "switch the servos' torque off, gently, when no server is running",
        f"Lower the servos' torque over {LOWER_S} s, switch it off, and check servo by servo that it is. "
        "The arm sinks: support it. While a server is running, call its service /arm/relax instead.",
    )
    add_arm(parser)


def _relax(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    hardware = read_hardware(options, get_args(ServoKind))
    family = family_of(cast(ServoKind, hardware.kind))
    with contextlib.closing(family.bus.open(resolve_port(options.serial), hardware.baud)) as bus:
        return relax_arm(bus, hardware.servos, terminal, family)


def relax_arm(
    bus: ServoBus, servos: Sequence[ServoSpec], terminal: Terminal, family: ServoFamily | None = None
) -> ExitCode:
    """Relax whatever holds; says which servos may still be driven. The family is Feetech's unless it is given."""
    holding, full, silent = _look(family or Feetech(), bus, servos)
    if not holding and not silent:
        terminal.err("torque is off on all servos")
        return ExitCode.DONE
    if len(silent) == len(servos):
        terminal.err("no servo answers: see armbridge scan")
        return ExitCode.FAILED
    terminal.err("relaxing: support the arm ...")
    # Broken off halfway, servos would hold with the torque that is left.
    with signals_wait():
        if family is not None and family.watchdog is not None:
            # Without its program a servo has stopped, and takes no limit until its watchdog is disarmed.
            write_limits(bus, {servo_id: Limit(family.watchdog.register, 0) for servo_id in holding})
        driven = run_to_end(relax(bus, [servo.servo_id for servo in servos], holding, full))
    if driven:
        listed = ", ".join(f"{servo.joint} (id {servo.servo_id})" for servo in servos if servo.servo_id in driven)
        terminal.err(f"{listed} may still be driven: torque off could not be verified. Cut the servos' supply.")
        return ExitCode.PROBLEMS
    terminal.err("torque is off on all servos")
    return ExitCode.DONE


def _look(
    family: ServoFamily, bus: ServoBus, servos: Sequence[ServoSpec]
) -> tuple[dict[int, Limit], dict[int, Limit], list[int]]:
    present: dict[int, Limit] = {}
    full: dict[int, Limit] = {}
    silent, arm = [], Calibration.nominal(servos)
    for joint, share in zip(arm.joints, full_torque(arm, GuardLimits()), strict=True):
        servo_id, values = joint.servo_id, dict[Any, int]()
        try:
            if bus.read(servo_id, bus.registers.torque_enable):
                for block in family.survey_blocks(joint):
                    values |= run_to_end(read_registers(bus, servo_id, block))
                limit = family.limit(joint, values, share)
                present[servo_id] = Limit(limit.register, bus.read(servo_id, limit.register))
                full[servo_id] = limit
        except NoReply:
            silent.append(servo_id)
    return present, full, silent


def add_verify_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "verify",
        _verify,
        "have a running server compare the arm with its model, pose by pose, with you",
        "Ask the server to move the arm slowly to three poses, compare each with the model (on the "
        "server's page), and measure how far each joint stands from its goal. Nothing moves before you say so."
        + WITH_TOKEN,
    )
    parser.add_argument("--url", type=websocket_url, default=DEFAULT_URL, help=f"of the server ({DEFAULT_URL})")
    parser.add_argument("--arm", default="", metavar="NAME", help="one of several arms of the server, as in left")


def _verify(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.commands.verification_client import verify

    return verify(options.url, token_from_environment(), terminal, options.arm)
