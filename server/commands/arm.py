"""Commands on a real arm: ``armbridge scan``, ``calibrate``, ``doctor`` and ``relax``."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import textwrap
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from robot.calibration import Calibration, new_calibration_path, reserved, save
from robot.commissioning.calibrate import Difference, Sweep, calibrate, differences, write_to_servos
from robot.commissioning.doctor import (
    EXPERIMENTS,
    Experiment,
    Finding,
    ServoRig,
    Verdict,
    judge_cycles,
    judge_long_reads,
    judge_scan,
    run_experiment,
)
from robot.commissioning.scan import BAUDRATES, ScanResult, ServoReport, explain_missing, read_telemetry, scan
from robot.commissioning.timing import measure_cycles, measure_reads
from robot.description.limits import JointBounds
from robot.description.servo_table import ServoSpec
from robot.errors import NoReply, StartupError
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import TELEMETRY_ADDRESS, TELEMETRY_BYTES, Register, parse_telemetry
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.feetech.torque import LOWER_S, relax
from robot.hardware.interface import run_to_end, status_names
from robot.hardware.port import resolve_port
from server.commands.options import (
    Subparsers,
    add_calibration,
    add_robot,
    add_serial,
    guarded,
    open_bus,
    read_calibration,
    read_hardware,
)
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal, table

HEADINGS = (
    "id", "joint", "model", "firmware", "V", "degC", "mode", "position", "limits", "offset", "torque", "complaints",
)  # fmt: skip


def add_scan_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "scan",
        help="list the servos on the bus, and say which are missing and why",
        description="List every servo on the bus: id, model, firmware, supply voltage, temperature, operating mode, "
        "position, angle limits, homing offset [ticks], and whether torque is on. Only reads; nothing moves.",
        epilog=EXIT_CODES,
    )
    add_robot(parser)
    add_serial(parser)
    parser.add_argument("--all-bauds", action="store_true", help="look at every baud rate, not only at 1000000")
    parser.set_defaults(run=run_scan)


def run_scan(options: argparse.Namespace) -> int:
    """Carry out the command."""
    return guarded(lambda terminal: _scan(options, terminal))


def _scan(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    servos, port = read_hardware(options).servos, resolve_port(options.serial)
    names = {servo.servo_id: servo.joint for servo in servos}
    complaints: list[str] = []
    for baudrate in BAUDRATES if options.all_bauds else BAUDRATES[:1]:
        terminal.say(f"scanning {port} at {baudrate} baud ...")
        with contextlib.closing(Bus.open(port, baudrate)) as bus:
            result = scan(bus, tuple(names))
        if result.servos:
            terminal.tell(table(HEADINGS, [_row(servo, names) for servo in result.servos]))
        complaints += _complaints(result, servos, baudrate)
    for complaint in complaints:
        terminal.say(complaint)
    return ExitCode.PROBLEMS if complaints else ExitCode.DONE


def _complaints(result: ScanResult, servos: Sequence[ServoSpec], baudrate: int) -> list[str]:
    if baudrate == BAUDRATES[0]:
        return explain_missing(result, servos)
    return [f"servo {servo_id} listens at {baudrate} baud: set it to {BAUDRATES[0]}" for servo_id in sorted(result.ids)]


def _row(servo: ServoReport, names: Mapping[int, str]) -> list[object]:
    telemetry = servo.telemetry
    return [
        servo.servo_id,
        names.get(servo.servo_id, "?"),
        servo.model,
        f"{servo.firmware[0]}.{servo.firmware[1]}",
        f"{telemetry.voltage_v:.1f}",
        telemetry.temperature_c,
        servo.mode,
        telemetry.position_ticks,
        f"{servo.angle_limits_ticks[0]}..{servo.angle_limits_ticks[1]}",
        servo.homing_offset_ticks,
        "on" if servo.torque_enable else "off",
        ", ".join(status_names(telemetry.status)) or "-",
    ]


# Fast enough to follow a hand across the seam (no joint turns by half a turn meanwhile), slow enough to be read.
SWEEP_PERIOD_S = 0.02


def add_calibrate_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "calibrate",
        help="record the arm's middle pose and joint ranges in a calibration file of lerobot's format",
        description="Switches torque off, asks you to hold the arm with every joint in the middle of its range, then "
        "to move every joint that has stops from one to the other, and writes a file like lerobot's. "
        "Nothing is written to the servos unless you say --write-servos.",
        epilog=EXIT_CODES,
    )
    parser.add_argument(
        "file", metavar="NAME_OR_PATH", help="where to write: a file, or an id for lerobot's calibration directory"
    )
    add_robot(parser)
    add_serial(parser)
    parser.add_argument(
        "--write-servos",
        action="store_true",
        help="choose new homing offsets and write them and the angle limits into the servos' EPROM, where they differ",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace the file if it is there")
    parser.add_argument("--yes", action="store_true", help="do not ask before torque is switched off")
    parser.set_defaults(run=run_calibrate)


def run_calibrate(options: argparse.Namespace) -> int:
    """Carry out the command."""
    return guarded(lambda terminal: _calibrate(options, terminal))


def _calibrate(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    hardware = read_hardware(options)
    path = new_calibration_path(options.file, hardware.calibrations, os.environ)
    with reserved(path, overwrite=options.overwrite):
        return _calibrate_to(path, hardware.servos, options, terminal)


def _calibrate_to(path: Path, servos: Sequence[ServoSpec], options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    ids = tuple(servo.servo_id for servo in servos)
    with contextlib.closing(open_bus(options)) as bus:
        terminal.say("looking at the servos ...")
        result = scan(bus, ids)
        if missing := explain_missing(result, servos):
            raise StartupError("; ".join(missing))
        if not options.yes and not terminal.confirm("Torque will be switched off and the arm sinks: hold it. Go on?"):
            return ExitCode.FAILED
        if relax_arm(bus, servos, terminal) is not ExitCode.DONE:
            return ExitCode.FAILED
        offsets = {servo.servo_id: servo.homing_offset_ticks for servo in result.servos}
        sweep = _sweep(bus, servos, terminal)
        calibration = calibrate(servos, sweep, offsets, recentre=options.write_servos)
        changes = differences(calibration, scan(bus, ids).servos)
        if options.write_servos:
            _write(bus, changes, terminal)
        elif changes:
            terminal.say("the servos' angle limits stay as they are (--write-servos would change them):")
            terminal.say(_differences_table(changes))
    save(calibration, path)
    terminal.tell(_calibration_table(calibration))
    terminal.say(f"written to {path}")
    return ExitCode.DONE


def _sweep(bus: Bus, servos: Sequence[ServoSpec], terminal: Terminal) -> Sweep:
    ids = tuple(servo.servo_id for servo in servos)
    free = "".join(f" but {servo.joint}" for servo in servos if servo.turns_freely)
    gripper = "".join(f", the {servo.joint} from closed to open" for servo in servos if servo.gripper)
    terminal.await_enter("Hold the arm with every joint in the middle of its range")
    sweep = Sweep({servo_id: read_telemetry(bus, servo_id).position_ticks for servo_id in ids})
    terminal.say(f"Move every joint{free} slowly from stop to stop{gripper}. Press Enter when the ranges grow no more.")
    while not terminal.entered():
        frames = bus.sync_read(ids, TELEMETRY_ADDRESS, TELEMETRY_BYTES)
        sweep.add({servo_id: parse_telemetry(frame.data).position_ticks for servo_id, frame in frames.items()})
        terminal.show_live(_sweep_table(servos, sweep))
        time.sleep(SWEEP_PERIOD_S)
    return sweep


def _write(bus: Bus, changes: list[Difference], terminal: Terminal) -> None:
    if not changes:
        terminal.say("the servos hold these values already")
        return
    terminal.say("writing to the servos:")
    terminal.say(_differences_table(changes))
    run_to_end(write_to_servos(bus, changes))


def _sweep_table(servos: Sequence[ServoSpec], sweep: Sweep) -> str:
    rows = [
        (servo.joint, *(by_id[servo.servo_id] for by_id in (sweep.lowest, sweep.present, sweep.highest)))
        for servo in servos
    ]
    return table(("joint", "lowest", "present", "highest"), rows)


def _calibration_table(calibration: Calibration) -> str:
    rows = [
        (joint.joint, joint.servo_id, joint.homing_offset, joint.range_min, joint.range_max)
        for joint in calibration.joints
    ]
    return table(("joint", "id", "homing_offset", "range_min", "range_max"), rows)


def _differences_table(changes: list[Difference]) -> str:
    rows = [(each.joint, each.register.name, each.in_servo, each.calibrated) for each in changes]
    return table(("joint", "register", "in the servo", "calibrated"), rows)


# Three seconds at 100 Hz: enough for a 99th percentile.
DEFAULT_CYCLES = 300

# The highest register that the bus's reads of varying length ever ask for, and as many bytes as it asks at most.
LONG_READ_ADDRESS = 56
LONG_READ_BYTES = 31

LINE_WIDTH = 100


def add_doctor_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "doctor",
        help="measure the arm and its bus, judge them, and say what to do",
        description="Look at every servo, measure the bus for a few seconds, and print a verdict per check with what "
        "to do. Then, one by one and only if you agree, ask the arm what no document says; some of these questions "
        "switch one servo's torque (see --servo) or move it by 2 degrees.",
        epilog=EXIT_CODES,
    )
    add_robot(parser)
    add_serial(parser)
    add_calibration(parser)
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")
    parser.add_argument("--cycles", type=int, default=DEFAULT_CYCLES, metavar="N", help=f"measured ({DEFAULT_CYCLES})")
    agreement = parser.add_mutually_exclusive_group()
    agreement.add_argument("--yes", action="store_true", help="agree to every question that needs no hands")
    agreement.add_argument("--read-only", action="store_true", help="ask none of these questions, and write nothing")
    parser.add_argument(
        "--servo",
        type=int,
        metavar="ID",
        help="servo that may be driven; it must be relaxed (the last one: the gripper, of which nothing falls)",
    )
    parser.set_defaults(run=run_doctor)


def run_doctor(options: argparse.Namespace) -> int:
    """Carry out the command."""
    if options.cycles < 1:
        Terminal().say(f"armbridge: --cycles must be at least 1, not {options.cycles}")
        return ExitCode.USAGE
    return guarded(lambda terminal: _doctor(options, terminal))


def _doctor(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    calibration, servos = read_calibration(options), read_hardware(options).servos
    ids = tuple(servo.servo_id for servo in servos)
    driven = ids[-1] if options.servo is None else options.servo
    if driven not in ids:
        terminal.say(f"armbridge: --servo must be one of {', '.join(map(str, ids))}, not {driven}")
        return ExitCode.USAGE
    with contextlib.closing(open_bus(options)) as bus:
        terminal.say("looking at the servos ...")
        result = scan(bus, ids)
        findings = judge_scan(result, servos, calibration)
        present = tuple(servo.servo_id for servo in result.servos)
        if present:
            findings += _measure(bus, present, options.cycles, terminal)
        if driven in present and not options.read_only:
            findings += _experiment(ServoRig(bus, driven, present), terminal, yes=options.yes)
    terminal.tell(_as_json(findings) if options.json else _as_text(findings))
    problems = any(finding.verdict is Verdict.PROBLEM for finding in findings)
    return ExitCode.PROBLEMS if problems else ExitCode.DONE


def _measure(bus: Bus, ids: tuple[int, ...], cycles: int, terminal: Terminal) -> list[Finding]:
    terminal.say(f"measuring {cycles} cycles at 100 Hz ...")
    findings = judge_cycles(measure_cycles(bus, ids, cycles))
    attempts = 5  # a single reply may get lost
    silent = [i for i in ids if not measure_reads(bus, i, LONG_READ_ADDRESS, LONG_READ_BYTES, attempts)]
    return [*findings, judge_long_reads(LONG_READ_ADDRESS, LONG_READ_BYTES, silent)]


def _experiment(rig: ServoRig, terminal: Terminal, *, yes: bool) -> list[Finding]:
    findings = []
    for experiment in EXPERIMENTS:
        if _agreed(experiment, rig, terminal, yes=yes):
            terminal.say(f"asking: {experiment.name} ...")
            findings.append(run_experiment(experiment, rig))
        else:
            findings.append(Finding(experiment.name, Verdict.OPEN, "not asked"))
    return findings


def _agreed(experiment: Experiment, rig: ServoRig, terminal: Terminal, *, yes: bool) -> bool:
    if yes:
        return not experiment.needs_hands
    driven = f" (servo {rig.servo_id})" if experiment.switches_torque else ""
    return terminal.confirm(f"{experiment.name}: {experiment.does}{driven}. Go on?")


def _as_json(findings: list[Finding]) -> str:
    return json.dumps(
        [
            {"check": finding.check, "verdict": finding.verdict.value, "says": finding.says, "remedy": finding.remedy}
            for finding in findings
        ],
        indent=2,
    )


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
    """Describe the command."""
    parser = subparsers.add_parser(
        "relax",
        help="switch the servos' torque off, gently, when no server is running",
        description=f"Lower the servos' torque over {LOWER_S} s, switch it off, and check servo by servo that it is. "
        "The arm sinks: support it. While a server is running, call its service /arm/relax instead.",
        epilog=EXIT_CODES,
    )
    add_robot(parser)
    add_serial(parser)
    parser.set_defaults(run=run_relax)


def run_relax(options: argparse.Namespace) -> int:
    """Carry out the command."""
    return guarded(lambda terminal: _relax(options, terminal))


def _relax(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    servos = read_hardware(options).servos
    with contextlib.closing(open_bus(options)) as bus:
        return relax_arm(bus, servos, terminal)


def relax_arm(bus: Bus, servos: Sequence[ServoSpec], terminal: Terminal) -> ExitCode:
    """Relax whatever holds; says which servos may still be driven.

    Args:
        bus: an open bus.
        servos: servos of the arm.
        terminal: tells.

    Raises:
        PortLost: the port is gone.
    """
    holding, silent = _look(bus, servos)
    if not holding and not silent:
        terminal.say("torque is off on all servos")
        return ExitCode.DONE
    if len(silent) == len(servos):
        terminal.say("no servo answers: see armbridge scan")
        return ExitCode.FAILED
    terminal.say("relaxing: support the arm ...")
    servo_map = _servo_map(servos)
    driven = run_to_end(relax(bus, servo_map, holding))
    if driven:
        listed = ", ".join(servo_map.label(servo_id) for servo_id in driven)
        terminal.say(f"{listed} may still be driven: torque off could not be verified. Cut the servos' supply.")
        return ExitCode.PROBLEMS
    terminal.say("torque is off on all servos")
    return ExitCode.DONE


def _look(bus: Bus, servos: Sequence[ServoSpec]) -> tuple[dict[int, int], list[int]]:
    """Torque limits of the servos that hold, by id [0.1 %], and the servos that do not answer."""
    holding, silent = {}, []
    for joint in servos:
        try:
            if bus.read(joint.servo_id, Register.TORQUE_ENABLE):
                holding[joint.servo_id] = bus.read(joint.servo_id, Register.TORQUE_LIMIT)
        except NoReply:
            silent.append(joint.servo_id)
    return holding, silent


def _servo_map(servos: Sequence[ServoSpec]) -> ServoMap:
    """Return the servos by joint; their ranges do not matter where torque goes off."""
    ones = np.ones(len(servos))
    return ServoMap(Calibration.nominal(servos), JointBounds(-np.pi * ones, np.pi * ones, ones, ones))
