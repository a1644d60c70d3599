"""``armbridge replay``: a recording, published again by a server without an arm."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from robot import logs
from server.commands.options import Subparsers
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal
from server.errors import ConfigurationError, RecordingError, StartError

MAX_PORT = 65_535
MIN_RATE, MAX_RATE = 0.01, 100.0
MAX_DELAY_S = 3600.0


def add_parser(subparsers: Subparsers) -> None:
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
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
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
    place = {name: value for name in ("host", "port") if (value := getattr(options, name)) is not None}
    return {"server": place, "access": {"insecure": True} if options.insecure else {}}


def _number(kind: Callable[[str], float], least: float, greatest: float) -> Callable[[str], float]:
    """What reads a number of an option, within bounds."""

    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = float("nan")
        if not least <= value <= greatest:
            raise argparse.ArgumentTypeError(f"must be {least:g} to {greatest:g}, not {text!r}")
        return value

    return read
