"""``armbridge serve``: the server."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path
from typing import Any

from robot.processes import LOG_FORMAT
from server.commands.arm_options import CALIBRATION_HELP, Subparsers
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal
from server.config import Settings, load
from server.errors import ConfigurationError, StartError

# Option -> its section and key in the settings.
_KEYS = {
    "host": ("server", "host"),
    "port": ("server", "port"),
    "log_level": ("server", "log_level"),
    "serial": ("arm", "serial"),
    "calibration": ("arm", "calibration"),
    "urdf": ("arm", "urdf"),
    "srdf": ("arm", "srdf"),
}


def add_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    serve = subparsers.add_parser(
        "serve",
        help="start the server, with the simulated arm unless --serial names a real one",
        description="Start the server. Without --serial it drives a simulated arm: the same driver, an emulated bus.",
        epilog=EXIT_CODES,
    )
    serve.add_argument("--host", help="address to listen on (127.0.0.1)")
    serve.add_argument("--port", type=int, help="TCP port (9090); 0 takes a free one")
    serve.add_argument(
        "--serial",
        metavar="PORT",
        help="servo bus of a real arm: a path such as /dev/serial/by-id/..., a USB id, a URL, or auto",
    )
    serve.add_argument("--calibration", metavar="NAME_OR_PATH", help=CALIBRATION_HELP)
    serve.add_argument("--urdf", type=Path, metavar="FILE", help="the robot's URDF, instead of the built-in SO-101's")
    serve.add_argument("--srdf", type=Path, metavar="FILE", help="the SRDF that goes with --urdf")
    serve.add_argument("--config", type=Path, metavar="FILE", help="settings in TOML; options given here override them")
    serve.add_argument(
        "--log-level", choices=("debug", "info", "warning", "error"), help="least level of the log (info)"
    )
    serve.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command."""
    terminal = Terminal()
    try:
        settings = load(options.config, _overrides(options))
    except ConfigurationError as error:
        terminal.say(f"armbridge: {error}")
        return ExitCode.USAGE
    return _serve(settings, terminal)


def _serve(settings: Settings, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.app import serve

    logging.basicConfig(level=settings.server.log_level.upper(), format=LOG_FORMAT, stream=sys.stderr)
    # A line for every handshake and request that is no WebSocket; the gateway tells what matters of a client.
    logging.getLogger("websockets").setLevel(logging.WARNING)
    try:
        serve(settings)
    except (StartError, ConfigurationError) as error:
        terminal.say(f"armbridge: {error}")
        return ExitCode.FAILED
    return ExitCode.DONE


def _overrides(options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """The settings that options override, by section and key."""
    overrides: dict[str, dict[str, Any]] = {}
    for option, (section, key) in _KEYS.items():
        value = getattr(options, option)
        if value is not None:
            overrides.setdefault(section, {})[key] = value
    return overrides
