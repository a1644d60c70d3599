"""``armbridge doctor``: measure the arm, judge it, and say what to do."""

from __future__ import annotations

import argparse
import contextlib
import json
import textwrap

from robot.calibration import SO101_JOINTS
from robot.commissioning.doctor import Finding, Verdict, judge_cycles, judge_long_reads, judge_scan
from robot.commissioning.experiments import EXPERIMENTS, Experiment, ServoRig, run_experiment
from robot.commissioning.scan import scan
from robot.commissioning.timing import measure_cycles, measure_reads
from robot.hardware.feetech.bus import Bus
from server.commands.options import (
    Subparsers,
    add_calibration,
    add_serial,
    guarded,
    open_bus,
    read_calibration,
)
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal, table

IDS = tuple(joint.servo_id for joint in SO101_JOINTS)

# Three seconds at 100 Hz: enough for a 99th percentile.
DEFAULT_CYCLES = 300

# The highest register that the bus's reads of varying length ever ask for, and as many bytes as it asks at most.
LONG_READ_ADDRESS = 56
LONG_READ_BYTES = 31

# The gripper: nothing falls when it is relaxed, and a finger stops it.
DEFAULT_SERVO = 6

LINE_WIDTH = 100


def add_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "doctor",
        help="measure the arm and its bus, judge them, and say what to do",
        description="Look at every servo, measure the bus for a few seconds, and print a verdict per check with what "
        "to do. Then, one by one and only if you agree, ask the arm what no document says; some of these questions "
        "switch one servo's torque (see --servo) or move it by 2 degrees.",
        epilog=EXIT_CODES,
    )
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
        choices=IDS,
        default=DEFAULT_SERVO,
        help=f"servo that may be driven; it must be relaxed ({DEFAULT_SERVO}, the gripper)",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command."""
    if options.cycles < 1:
        Terminal().say(f"armbridge: --cycles must be at least 1, not {options.cycles}")
        return ExitCode.USAGE
    return guarded(lambda terminal: _doctor(options, terminal))


def _doctor(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    calibration = read_calibration(options)
    with contextlib.closing(open_bus(options)) as bus:
        terminal.say("looking at the servos ...")
        result = scan(bus, IDS)
        findings = judge_scan(result, calibration)
        present = tuple(servo.servo_id for servo in result.servos)
        if present:
            findings += _measure(bus, present, options.cycles, terminal)
        if options.servo in present and not options.read_only:
            findings += _experiment(ServoRig(bus, options.servo, present), terminal, yes=options.yes)
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
