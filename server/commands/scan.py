"""``armbridge scan``: who is on the bus, and what is missing."""

from __future__ import annotations

import argparse
import contextlib

from robot.calibration import SO101_JOINTS
from robot.commissioning.scan import BAUDRATES, ScanResult, ServoReport, explain_missing, scan
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.port import resolve_port
from robot.hardware.interface import status_names
from server.commands.options import Subparsers, add_serial, guarded
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal, table

HEADINGS = (
    "id", "joint", "model", "firmware", "V", "degC", "mode", "position", "limits", "offset", "torque", "complaints",
)  # fmt: skip
IDS = tuple(joint.servo_id for joint in SO101_JOINTS)
NAMES = {joint.servo_id: joint.name for joint in SO101_JOINTS}


def add_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "scan",
        help="list the servos on the bus, and say which are missing and why",
        description="List every servo on the bus: id, model, firmware, supply voltage, temperature, operating mode, "
        "position, angle limits, homing offset [ticks], and whether torque is on. Only reads; nothing moves.",
        epilog=EXIT_CODES,
    )
    add_serial(parser)
    parser.add_argument("--all-bauds", action="store_true", help="look at every baud rate, not only at 1000000")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command."""
    return guarded(lambda terminal: _scan(options, terminal))


def _scan(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    port = resolve_port(options.serial)
    complaints: list[str] = []
    for baudrate in BAUDRATES if options.all_bauds else BAUDRATES[:1]:
        terminal.say(f"scanning {port} at {baudrate} baud ...")
        with contextlib.closing(Bus.open(port, baudrate)) as bus:
            result = scan(bus, IDS)
        if result.servos:
            terminal.tell(table(HEADINGS, [_row(servo) for servo in result.servos]))
        complaints += _complaints(result, baudrate)
    for complaint in complaints:
        terminal.say(complaint)
    return ExitCode.PROBLEMS if complaints else ExitCode.DONE


def _complaints(result: ScanResult, baudrate: int) -> list[str]:
    if baudrate == BAUDRATES[0]:
        return explain_missing(result, SO101_JOINTS)
    return [f"servo {servo_id} listens at {baudrate} baud: set it to {BAUDRATES[0]}" for servo_id in sorted(result.ids)]


def _row(servo: ServoReport) -> list[object]:
    telemetry = servo.telemetry
    return [
        servo.servo_id,
        NAMES.get(servo.servo_id, "?"),
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
