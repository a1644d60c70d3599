"""``armbridge calibrate``: lerobot's calibration procedure, with its file as the result."""

from __future__ import annotations

import argparse
import contextlib
import os
import time

from robot.calibration import FREE_TURNING_JOINT, SO101_JOINTS, Calibration, new_calibration_path, save
from robot.commissioning.calibrate import Difference, Sweep, calibrate, differences, write_to_servos
from robot.commissioning.scan import explain_missing, read_telemetry, scan
from robot.errors import CalibrationError, StartupError
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import TELEMETRY_ADDRESS, TELEMETRY_BYTES, parse_telemetry
from robot.hardware.interface import run_to_end
from server.commands.options import Subparsers, add_serial, guarded, open_bus
from server.commands.relax import relax_arm
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal, table

IDS = tuple(joint.servo_id for joint in SO101_JOINTS)

# Fast enough to follow a hand across the seam (no joint turns by half a turn meanwhile), slow enough to be read.
SWEEP_PERIOD_S = 0.02


def add_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "calibrate",
        help="record the arm's middle pose and joint ranges in a calibration file of lerobot's format",
        description="Switches torque off, asks you to hold the arm with every joint in the middle of its range, then "
        f"to move every joint but {FREE_TURNING_JOINT} from stop to stop, and writes a file like lerobot's. "
        "Nothing is written to the servos unless you say --write-servos.",
        epilog=EXIT_CODES,
    )
    parser.add_argument(
        "file", metavar="NAME_OR_PATH", help="where to write: a file, or an id for lerobot's calibration directory"
    )
    add_serial(parser)
    parser.add_argument(
        "--write-servos",
        action="store_true",
        help="choose new homing offsets and write them and the angle limits into the servos' EPROM, where they differ",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace the file if it is there")
    parser.add_argument("--yes", action="store_true", help="do not ask before torque is switched off")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command."""
    return guarded(lambda terminal: _calibrate(options, terminal))


def _calibrate(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    path = new_calibration_path(options.file, os.environ)
    if path.exists() and not options.overwrite:
        raise CalibrationError(str(path), "", "is there already: choose another name, or --overwrite it")
    with contextlib.closing(open_bus(options)) as bus:
        terminal.say("looking at the servos ...")
        result = scan(bus, IDS)
        if missing := explain_missing(result, SO101_JOINTS):
            raise StartupError("; ".join(missing))
        if not options.yes and not terminal.confirm("Torque will be switched off and the arm sinks: hold it. Go on?"):
            return ExitCode.FAILED
        if relax_arm(bus, terminal) is not ExitCode.DONE:
            return ExitCode.FAILED
        offsets = {servo.servo_id: servo.homing_offset_ticks for servo in result.servos}
        sweep = _sweep(bus, terminal)
        calibration = calibrate(SO101_JOINTS, sweep, offsets, recentre=options.write_servos)
        changes = differences(calibration, scan(bus, IDS).servos)
        if options.write_servos:
            _write(bus, changes, terminal)
        elif changes:
            terminal.say("the servos' angle limits stay as they are (--write-servos would change them):")
            terminal.say(_differences_table(changes))
    save(calibration, path)
    terminal.tell(_calibration_table(calibration))
    terminal.say(f"written to {path}")
    return ExitCode.DONE


def _sweep(bus: Bus, terminal: Terminal) -> Sweep:
    terminal.await_enter("Hold the arm with every joint in the middle of its range")
    sweep = Sweep({servo_id: read_telemetry(bus, servo_id).position_ticks for servo_id in IDS})
    terminal.say(
        f"Move every joint but {FREE_TURNING_JOINT} slowly from stop to stop, the gripper from closed to open. "
        "Press Enter when the ranges grow no more."
    )
    while not terminal.entered():
        frames = bus.sync_read(IDS, TELEMETRY_ADDRESS, TELEMETRY_BYTES)
        sweep.add({servo_id: parse_telemetry(frame.data).position_ticks for servo_id, frame in frames.items()})
        terminal.show_live(_sweep_table(sweep))
        time.sleep(SWEEP_PERIOD_S)
    return sweep


def _write(bus: Bus, changes: list[Difference], terminal: Terminal) -> None:
    if not changes:
        terminal.say("the servos hold these values already")
        return
    terminal.say("writing to the servos:")
    terminal.say(_differences_table(changes))
    run_to_end(write_to_servos(bus, changes))


def _sweep_table(sweep: Sweep) -> str:
    rows = [
        (joint.name, *(by_id[joint.servo_id] for by_id in (sweep.lowest, sweep.present, sweep.highest)))
        for joint in SO101_JOINTS
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
