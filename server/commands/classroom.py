"""Command that runs until it is ended: ``armbridge classroom``."""

from __future__ import annotations

import argparse
import logging
import os
from collections.abc import Callable
from pathlib import Path

from robot import logs
from server.commands.options import Subparsers, add_setting_options, read_settings
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal
from server.errors import ConfigurationError, StartError

MAX_STUDENTS = 50
MAX_PLANNERS = 16

# Two at least, so that a student whose goal takes long leaves one for the others.
LEAST_PLANNERS = 2


def add_classroom_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "classroom",
        help="start a simulated arm for each student, each with its port, folder and token",
        description="Start a server with a simulated arm for each student on this machine. All share the planners. "
        "Names, addresses and tokens are written to students.csv in the folder of --data.",
        epilog=EXIT_CODES,
    )
    parser.add_argument(
        "--students", type=_number(MAX_STUDENTS), default=20, metavar="N", help=f"1 to {MAX_STUDENTS} (20)"
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=Path("classroom"),
        metavar="DIR",
        help="folder for the list of students and what their servers keep (classroom)",
    )
    parser.add_argument(
        "--planners",
        type=_number(MAX_PLANNERS),
        default=max(LEAST_PLANNERS, (os.cpu_count() or 1) // 2),
        metavar="N",
        help="motions that may be planned at the same time, for all together (half the cores, at least 2)",
    )
    add_setting_options(parser)
    parser.set_defaults(run=run_classroom_command)


def run_classroom_command(options: argparse.Namespace) -> int:
    """Carry out the command."""
    terminal = Terminal()
    # A thread of the linear algebra library would be in no fork, and its matrices here are tiny.
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    try:
        settings, _ = read_settings(options)
        logs.configure(settings.server.log_level.upper(), settings.server.log_format)
        logging.getLogger("websockets").setLevel(logging.WARNING)
        # Imported when it is needed: --help answers without the server's libraries.
        from server.classroom.classroom import ClassroomOptions, run_classroom

        run_classroom(settings, ClassroomOptions(options.students, options.planners, options.data))
    except ConfigurationError as error:
        terminal.say(f"armbridge: {error}")
        return ExitCode.USAGE
    except StartError as error:
        terminal.say(f"armbridge: {error}")
        return ExitCode.FAILED
    return ExitCode.DONE


def _number(most: int) -> Callable[[str], int]:
    """Return a reader of a number from 1 on."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = 0
        if not 1 <= value <= most:
            raise argparse.ArgumentTypeError(f"must be 1 to {most}, not {text!r}")
        return value

    return read
