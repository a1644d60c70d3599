"""Options that commands on the arm's bus share, and what they stand for."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from typing import TypeAlias

from robot.calibration import Calibration, find_calibration
from robot.errors import PortBusy, RobotError
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.port import AUTO, resolve_port
from server.commands.terminal import ExitCode, Terminal

Subparsers: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"  # noqa: SLF001 - argparse has no public name for it

SERIAL_HELP = (
    "the servos' port: a path such as /dev/serial/by-id/..., a USB id such as 1a86:55d3, a URL such as "
    "socket://host:port, or auto for the one adapter plugged in (auto)"
)
CALIBRATION_HELP = "the arm's calibration: a file, or the arm's id in lerobot's calibration directory"


def add_serial(parser: argparse.ArgumentParser) -> None:
    """Describe ``--serial``."""
    parser.add_argument("--serial", metavar="PORT", default=AUTO, help=SERIAL_HELP)


def add_calibration(parser: argparse.ArgumentParser) -> None:
    """Describe ``--calibration``."""
    parser.add_argument("--calibration", metavar="NAME_OR_PATH", help=CALIBRATION_HELP)


def open_bus(options: argparse.Namespace) -> Bus:
    """Open the bus that the options name.

    Raises:
        PortError: it cannot be opened.
    """
    return Bus.open(resolve_port(options.serial))


def read_calibration(options: argparse.Namespace) -> Calibration | None:
    """Read the calibration that the options name, if they name one.

    Raises:
        CalibrationError: it cannot be used.
    """
    if options.calibration is None:
        return None
    return Calibration.load(find_calibration(options.calibration, os.environ))


def guarded(command: Callable[[Terminal], ExitCode]) -> ExitCode:
    """Run a command on the arm; what it refuses or fails at becomes one line and an exit code."""
    terminal = Terminal()
    try:
        return command(terminal)
    except PortBusy as error:
        terminal.say(f"armbridge: {error}. If that is armbridge serve, stop it first or use its services.")
    except RobotError as error:
        terminal.say(f"armbridge: {error}")
    except KeyboardInterrupt:
        terminal.say("armbridge: stopped")
    return ExitCode.FAILED
