"""Command that runs until it is ended: ``armbridge classroom``."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from server.commands.options import Subparsers, add_command, add_setting_options, configure_logs, number, read_settings
from server.commands.terminal import ExitCode, Terminal

MAX_STUDENTS = 50
MAX_PLANNERS = 16

# Two at least, so that a student whose goal takes long leaves one for the others.
LEAST_PLANNERS = 2


def add_classroom_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = add_command(
        subparsers,
        "classroom",
        _run,
        "start a simulated arm for each student, each with its port, folder and token",
        "Start a server with a simulated arm for each student on this machine. All share the planners. "
        "Names, addresses and tokens are written to students.csv in the folder of --data.",
    )
    parser.add_argument(
        "--students", type=number(int, 1, MAX_STUDENTS), default=20, metavar="N", help=f"1 to {MAX_STUDENTS} (20)"
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
        type=number(int, 1, MAX_PLANNERS),
        default=max(LEAST_PLANNERS, (os.cpu_count() or 1) // 2),
        metavar="N",
        help="motions that may be planned at the same time, for all together (half the cores, at least 2)",
    )
    add_setting_options(parser)


def _run(options: argparse.Namespace, _terminal: Terminal) -> ExitCode:
    settings, _ = read_settings(options)
    configure_logs(settings)
    # Imported when it is needed: --help answers without the server's libraries.
    from server.classroom.classroom import ClassroomOptions, run_classroom

    run_classroom(settings, ClassroomOptions(options.students, options.planners, options.data))
    return ExitCode.DONE
