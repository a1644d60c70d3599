"""``armbridge emulate``: an emulated servo bus to try other programs on, or the commands of this one."""

from __future__ import annotations

import argparse

from robot.emulator import control
from robot.emulator.process import add_options
from robot.emulator.process import run as run_emulator
from robot.errors import CalibrationError
from server.commands.options import Subparsers
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal

SCRIPTS = """\
A script has the same commands, one JSON object a line, each with its time from the start of the script [s], increasing:

    {"at_s": 1.5, "hand": {"3": 1900}}
    {"at_s": 4, "hand": {"3": null}}

It starts with the first byte from a host. Commands that are carried out are shown on stderr, with their answers.
"""


def add_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "emulate",
        help="emulate the servo bus of an arm on a pseudo terminal",
        description="Emulate the six servos of an SO-101 on a pseudo terminal, print its path, and run until told to "
        "end. Other programs, and armbridge's commands with --serial, take the path for a serial port.",
        epilog=f"Standard input takes:\n\n{control.__doc__}\n{SCRIPTS}\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_options(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command."""
    try:
        run_emulator(options)
    except (CalibrationError, ValueError, OSError) as error:
        Terminal().say(f"armbridge: {error}")
        return ExitCode.FAILED
    return ExitCode.DONE
