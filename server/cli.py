"""The command ``armbridge``."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from robot.processes import LOG_FORMAT
from server.config import Settings, load
from server.errors import ConfigurationError, StartError

# Exit codes: 0 done, 1 could not run, 2 called wrongly (argparse's own).
EXIT_FAILED = 1
EXIT_USAGE = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        settings = load(options.config, _overrides(options))
    except ConfigurationError as error:
        print(f"armbridge: {error}", file=sys.stderr)  # noqa: T201 - the command's own output
        return EXIT_USAGE
    return _serve(settings)


def _serve(settings: Settings) -> int:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.app import serve

    logging.basicConfig(level=settings.server.log_level.upper(), format=LOG_FORMAT, stream=sys.stderr)
    # A line for every handshake and request that is no WebSocket; the gateway tells what matters of a client.
    logging.getLogger("websockets").setLevel(logging.WARNING)
    try:
        serve(settings)
    except (StartError, ConfigurationError) as error:
        print(f"armbridge: {error}", file=sys.stderr)  # noqa: T201 - the command's own output
        return EXIT_FAILED
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="armbridge", description="Drive an SO-101 robot arm from any rosbridge client, without ROS."
    )
    parser.add_argument("--version", action="version", version=f"armbridge {metadata.version('armbridge')}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    serve = commands.add_parser(
        "serve",
        help="start the server, with the simulated arm unless --serial names a real one",
        description="Start the server. Without --serial it drives a simulated arm: the same driver, an emulated bus.",
    )
    serve.add_argument("--host", help="address to listen on (127.0.0.1)")
    serve.add_argument("--port", type=int, help="TCP port (9090); 0 takes a free one")
    serve.add_argument(
        "--serial", metavar="PATH|URL|auto", help="servo bus of a real arm, such as /dev/serial/by-id/..."
    )
    serve.add_argument("--calibration", type=Path, metavar="FILE", help="calibration of the arm, in lerobot's format")
    serve.add_argument("--urdf", type=Path, metavar="FILE", help="the robot's URDF, instead of the built-in SO-101's")
    serve.add_argument("--srdf", type=Path, metavar="FILE", help="the SRDF that goes with --urdf")
    serve.add_argument("--config", type=Path, metavar="FILE", help="settings in TOML; options given here override them")
    serve.add_argument(
        "--log-level", choices=("debug", "info", "warning", "error"), help="least level of the log (info)"
    )
    return parser


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


def _overrides(options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    overrides: dict[str, dict[str, Any]] = {}
    for option, (section, key) in _KEYS.items():
        value = getattr(options, option)
        if value is not None:
            overrides.setdefault(section, {})[key] = value
    return overrides


if __name__ == "__main__":
    sys.exit(main())
