"""Commands that run until they are ended: ``armbridge serve``, ``replay``, ``classroom`` and ``emulate``."""

import argparse
import contextlib
import os
from pathlib import Path

from robot.emulator import control
from robot.emulator.process import add_options
from robot.emulator.process import run as run_emulator
from server.commands.options import (
    Subparsers,
    add_command,
    add_number,
    add_server_options,
    add_setting_options,
    configure_logs,
    read_settings,
)
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal
from server.errors import StartError


def add_serve_parser(subparsers: Subparsers) -> None:
    serve = add_command(
        subparsers,
        "serve",
        _serve,
        "start the server, with the simulated arm unless --serial names a real one",
        "Start the server. Without --serial it drives a simulated arm: the same code on emulated servos.",
    )
    add_setting_options(serve)


def _serve(options: argparse.Namespace, _terminal: Terminal) -> ExitCode:
    settings, _ = read_settings(options)
    configure_logs(settings)
    # The arm's process loads while this one does, which takes half of the time until the server is ready.
    from robot.arm import start_arm_process

    try:
        # The processes of several arms start side by side.
        started = None if settings.arms else start_arm_process()
    except OSError as error:
        raise StartError(f"the arm process cannot be started: {error}") from error
    # Imported when it is needed: --help answers without the server's libraries.
    from server.app import serve

    with contextlib.ExitStack() as stack:
        serve(settings, None if started is None else stack.enter_context(contextlib.closing(started)))
    return ExitCode.DONE


def add_replay_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "replay",
        _replay,
        "publish a recording again, without an arm",
        "Publish what was recorded with serve --record, or another MCAP file of ROS 2 messages, to any"
        " rosbridge client, as it was timed. There is no arm and no planner: goals are not answered. Of the settings,"
        " [server] and [access] count.",
    )
    parser.add_argument("recording", type=Path, metavar="FILE.mcap", help="the recording")
    add_server_options(parser)


def _replay(options: argparse.Namespace, _terminal: Terminal) -> ExitCode:
    from server.recording.replay import replay

    settings, _ = read_settings(options)
    configure_logs(settings)
    replay(options.recording, settings.server, settings.access)
    return ExitCode.DONE


MAX_STUDENTS = 50
MAX_PLANNERS = 16

# Two at least, so that a student whose goal takes long leaves one for the others.
LEAST_PLANNERS = 2


def add_classroom_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "classroom",
        _classroom,
        "start a simulated arm for each student, each with its port, folder and token",
        "Start a server with a simulated arm for each student on this machine. All share the planners. "
        "Names, addresses and tokens are written to students.csv in the folder of --data.",
    )
    add_number(parser, "--students", "N", (1, MAX_STUDENTS), 20, f"1 to {MAX_STUDENTS} (20)")
    parser.add_argument(
        "--physics",
        type=lambda text: text.split(","),
        default=[],
        metavar="NAMES",
        help="students whose arms have physics, as student01,student04; all have it with --simulation physics",
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=Path("classroom"),
        metavar="DIR",
        help="folder for the list of students and what their servers keep (classroom)",
    )
    half_the_cores = max(LEAST_PLANNERS, (os.cpu_count() or 1) // 2)
    text = "motions that may be planned at the same time, for all together (half the cores, at least 2)"
    add_number(parser, "--planners", "N", (1, MAX_PLANNERS), half_the_cores, text)
    add_setting_options(parser)


def _classroom(options: argparse.Namespace, _terminal: Terminal) -> ExitCode:
    settings, _ = read_settings(options)
    configure_logs(settings)
    from server.classroom import run_classroom

    run_classroom(settings, options.students, options.planners, options.data, options.physics)
    return ExitCode.DONE


SCRIPTS = """\
A script has the same commands, one JSON object a line, each with its time from the start of the script [s], increasing:

    {"at_s": 1.5, "hand": {"3": 1900}}
    {"at_s": 4, "hand": {"3": null}}

It starts with the first byte from a host. Commands that are carried out are shown on stderr, with their answers.
"""


def add_emulate_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "emulate",
        _emulate,
        "emulate the servo bus of an arm on a pseudo terminal",
        "Emulate the six Feetech servos of an SO-101 on a pseudo terminal, print its path, and run until Ctrl+C. "
        "Other programs, and armbridge's commands with --serial, take the path for a serial port.",
        epilog=f"Standard input takes:\n\n{control.COMMANDS_HELP}\n{SCRIPTS}\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_options(parser)


def _emulate(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    try:
        run_emulator(options)
    except (ValueError, OSError) as error:
        terminal.err(f"armbridge: {error}")
        return ExitCode.FAILED
    return ExitCode.DONE
