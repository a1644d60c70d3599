"""``armbridge serve``: the server."""

from __future__ import annotations

import argparse
import contextlib
import logging
from typing import TYPE_CHECKING

from robot import logs
from server.commands.options import Subparsers, add_setting_options, read_settings
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal
from server.config import Settings
from server.errors import ConfigurationError, StartError

if TYPE_CHECKING:
    from robot.processes import StartedChild


def add_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    serve = subparsers.add_parser(
        "serve",
        help="start the server, with the simulated arm unless --serial names a real one",
        description="Start the server. Without --serial it drives a simulated arm: the same code on emulated servos.",
        epilog=EXIT_CODES,
    )
    add_setting_options(serve)
    serve.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
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
    # The arm's process loads while this one does, which takes half of the time until the server is ready.
    from robot.arm import start_arm_process

    with contextlib.closing(start_arm_process()) as arm_process:
        return _serve_with(settings, arm_process, terminal)


def _serve_with(settings: Settings, arm_process: StartedChild, terminal: Terminal) -> ExitCode:
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
