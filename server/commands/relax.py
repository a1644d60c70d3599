"""``armbridge relax``: lower the arm gently and switch torque off."""

from __future__ import annotations

import argparse
import contextlib

from robot.calibration import SO101_JOINTS, Calibration
from robot.description import model
from robot.description.limits import JointBounds, within_calibration
from robot.errors import NoReply
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import Register
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.feetech.torque import LOWER_S, relax
from robot.hardware.interface import run_to_end
from server.commands.options import Subparsers, add_serial, guarded, open_bus
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal


def add_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "relax",
        help="switch the servos' torque off, gently, when no server is running",
        description=f"Lower the servos' torque over {LOWER_S} s, switch it off, and check servo by servo that it is. "
        "The arm sinks: support it. While a server is running, call its service /arm/relax instead.",
        epilog=EXIT_CODES,
    )
    add_serial(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command."""
    return guarded(lambda terminal: _relax(options, terminal))


def _relax(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    with contextlib.closing(open_bus(options)) as bus:
        return relax_arm(bus, terminal)


def relax_arm(bus: Bus, terminal: Terminal) -> ExitCode:
    """Relax whatever holds; says which servos may still be driven.

    Raises:
        PortLost: the port is gone.
    """
    holding, silent = _look(bus)
    if not holding and not silent:
        terminal.say("torque is off on all servos")
        return ExitCode.DONE
    if len(silent) == len(SO101_JOINTS):
        terminal.say("no servo answers: see armbridge scan")
        return ExitCode.FAILED
    terminal.say("relaxing: support the arm ...")
    servos = _servos()
    driven = run_to_end(relax(bus, servos, holding))
    if driven:
        listed = ", ".join(servos.label(servo_id) for servo_id in driven)
        terminal.say(f"{listed} may still be driven: torque off could not be verified. Cut the servos' supply.")
        return ExitCode.PROBLEMS
    terminal.say("torque is off on all servos")
    return ExitCode.DONE


def _look(bus: Bus) -> tuple[dict[int, int], list[int]]:
    """Torque limits of the servos that hold, by id [0.1 %], and the servos that do not answer."""
    holding, silent = {}, []
    for joint in SO101_JOINTS:
        try:
            if bus.read(joint.servo_id, Register.TORQUE_ENABLE):
                holding[joint.servo_id] = bus.read(joint.servo_id, Register.TORQUE_LIMIT)
        except NoReply:
            silent.append(joint.servo_id)
    return holding, silent


def _servos() -> ServoMap:
    calibration = Calibration.nominal()
    names = tuple(joint.joint for joint in calibration.joints)
    return ServoMap(calibration, JointBounds.of(within_calibration(model.builtin(), calibration), names))
