"""Commands that run until they are ended: ``armbridge serve``, ``replay`` and ``emulate``."""

from __future__ import annotations

import argparse
import contextlib
import logging
from typing import TYPE_CHECKING

from robot import logs
from server.commands.options import Subparsers, add_interfaces, add_setting_options, read_settings
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal
from server.config import Settings
from server.errors import ConfigurationError, StartError

if TYPE_CHECKING:
    from robot.processes import StartedChild
from collections.abc import Callable
from pathlib import Path
from typing import Any

from robot.emulator import control
from robot.emulator.process import add_options
from robot.emulator.process import run as run_emulator
from robot.errors import CalibrationError
from server.errors import RecordingError


def add_serve_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    serve = subparsers.add_parser(
        "serve",
        help="start the server, with the simulated arm unless --serial names a real one",
        description="Start the server. Without --serial it drives a simulated arm: the same code on emulated servos.",
        epilog=EXIT_CODES,
    )
    add_setting_options(serve)
    serve.set_defaults(run=run_serve)


def run_serve(options: argparse.Namespace) -> int:
    """Carry out the command."""
    terminal = Terminal()
    try:
        settings, _ = read_settings(options)
    except ConfigurationError as error:
        terminal.say(f"armbridge: {error}")
        return ExitCode.USAGE
    return _serve(settings, terminal)


def _serve(settings: Settings, terminal: Terminal) -> ExitCode:
    logs.configure(settings.server.log_level.upper(), settings.server.log_format)
    if settings.arms:
        # Those of several arms start side by side.
        return _serve_with(settings, None, terminal)
    # The arm's process loads while this one does, which takes half of the time until the server is ready.
    from robot.arm import start_arm_process

    try:
        started = start_arm_process()
    except OSError as error:
        terminal.say(f"armbridge: the arm process cannot be started: {error}")
        return ExitCode.FAILED
    with contextlib.closing(started) as arm_process:
        return _serve_with(settings, arm_process, terminal)


def _serve_with(settings: Settings, arm_process: StartedChild | None, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.app import serve

    # A line for every handshake and request that is no WebSocket; the gateway tells what matters of a client.
    logging.getLogger("websockets").setLevel(logging.WARNING)
    try:
        serve(settings, arm_process)
    except (StartError, ConfigurationError) as error:
        terminal.say(f"armbridge: {error}")
        return ExitCode.USAGE if isinstance(error, ConfigurationError) else ExitCode.FAILED
    return ExitCode.DONE


MAX_PORT = 65_535
MIN_RATE, MAX_RATE = 0.01, 100.0
MAX_DELAY_S = 3600.0


def add_replay_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "replay",
        help="publish a recording again, without an arm",
        description="Publish what was recorded with serve --record, or another MCAP file of ROS 2 messages, to any"
        " rosbridge client, as it was timed. There is no arm and no planner: goals are not answered.",
        epilog=EXIT_CODES,
    )
    parser.add_argument("recording", type=Path, metavar="FILE.mcap", help="the recording")
    parser.add_argument("--host", help="address to listen on (127.0.0.1)")
    parser.add_argument("--port", type=_number(int, 0, MAX_PORT), help="TCP port (9090); 0: a free one")
    parser.add_argument("--insecure", action="store_true", help="serve an address that others can reach without tokens")
    add_interfaces(parser)
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="settings in TOML, of which [server] and [access] count"
    )
    parser.add_argument(
        "--rate",
        type=_number(float, MIN_RATE, MAX_RATE),
        default=1.0,
        metavar="FACTOR",
        help=f"{MIN_RATE:g} to {MAX_RATE:g} times as fast as it was (1.0)",
    )
    parser.add_argument(
        "--delay",
        type=_number(float, 0.0, MAX_DELAY_S),
        default=0.0,
        metavar="S",
        help=f"begin after so many seconds, for clients to connect; up to {MAX_DELAY_S:g} (0)",
    )
    parser.add_argument("--loop", action="store_true", help="begin again at the end, until told to end")
    parser.set_defaults(run=run_replay)


def run_replay(options: argparse.Namespace) -> int:
    """Carry out the command."""
    # Imported when it is needed: --help answers without the server's libraries.
    from server.config_loader import load
    from server.recording.replay import ReplayOptions, replay

    try:
        settings = load(options.config, _overrides(options))
    except ConfigurationError as error:
        Terminal().say(f"armbridge: {error}")
        return ExitCode.USAGE
    logs.configure(settings.server.log_level.upper(), settings.server.log_format)
    logging.getLogger("websockets").setLevel(logging.WARNING)
    try:
        replay(
            ReplayOptions(
                options.recording, settings.server, settings.access, options.rate, options.delay, options.loop
            )
        )
    except (RecordingError, StartError, ConfigurationError) as error:
        Terminal().say(f"armbridge: {error}")
        return ExitCode.USAGE if isinstance(error, ConfigurationError) else ExitCode.FAILED
    return ExitCode.DONE


def _overrides(options: argparse.Namespace) -> dict[str, Any]:
    """The settings that options override, by section and key."""
    place = {name: value for name in ("host", "port", "interfaces") if (value := getattr(options, name)) is not None}
    return {"server": place, "access": {"insecure": True} if options.insecure else {}}


def _number(kind: Callable[[str], float], least: float, greatest: float) -> Callable[[str], float]:
    """Return a reader of an option's number, within bounds."""

    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = float("nan")
        if not least <= value <= greatest:
            raise argparse.ArgumentTypeError(f"must be {least:g} to {greatest:g}, not {text!r}")
        return value

    return read


SCRIPTS = """\
A script has the same commands, one JSON object a line, each with its time from the start of the script [s], increasing:

    {"at_s": 1.5, "hand": {"3": 1900}}
    {"at_s": 4, "hand": {"3": null}}

It starts with the first byte from a host. Commands that are carried out are shown on stderr, with their answers.
"""


def add_emulate_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "emulate",
        help="emulate the servo bus of an arm on a pseudo terminal",
        description="Emulate the six servos of an SO-101 on a pseudo terminal, print its path, and run until told to "
        "end. Other programs, and armbridge's commands with --serial, take the path for a serial port.",
        epilog=f"Standard input takes:\n\n{control.COMMANDS_HELP}\n{SCRIPTS}\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_options(parser)
    parser.set_defaults(run=run_emulate)


def run_emulate(options: argparse.Namespace) -> int:
    """Carry out the command."""
    try:
        run_emulator(options)
    except (CalibrationError, ValueError, OSError) as error:
        Terminal().say(f"armbridge: {error}")
        return ExitCode.FAILED
    return ExitCode.DONE
