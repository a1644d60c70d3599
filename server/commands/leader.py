"""``armbridge leader``: a relaxed arm at this machine, as the leader of an arm at a server elsewhere."""

from __future__ import annotations

import argparse
import asyncio
import os
from pathlib import Path
from typing import Any

from robot import logs
from server.commands.options import CALIBRATION_HELP, SERIAL_HELP, Subparsers, add_robot, websocket_url
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal
from server.commands.verify import DEFAULT_URL, TOKEN_VARIABLE
from server.errors import ConfigurationError

DEFAULT_TOPIC = "/leader/joint_states"
DEFAULT_RATE_HZ, MAX_RATE_HZ = 100, 100


def add_leader_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "leader",
        help="stream a relaxed arm to a server, whose arm follows it",
        description="Read an arm that is moved by hand, and publish its joints on a running server, whose arm follows "
        "them after /teleop/start with this topic as its leader (docs/teleoperation.md). The arm never gets torque. It "
        "connects again when the server comes back, and ends with Ctrl+C. Without --serial the arm is emulated.",
        epilog=EXIT_CODES,
    )
    parser.add_argument(
        "--connect", type=websocket_url, default=DEFAULT_URL, metavar="URL", help=f"of the server ({DEFAULT_URL})"
    )
    parser.add_argument("--serial", metavar="PORT", help=f"{SERIAL_HELP} (an emulated arm)")
    add_robot(parser, None)
    parser.add_argument("--calibration", metavar="NAME_OR_PATH", help=CALIBRATION_HELP)
    parser.add_argument("--topic", default=DEFAULT_TOPIC, help=f"of the joints ({DEFAULT_TOPIC})")
    parser.add_argument(
        "--rate", type=_rate, default=DEFAULT_RATE_HZ, metavar="HZ", help=f"samples a second ({DEFAULT_RATE_HZ})"
    )
    parser.add_argument(
        "--emulator-control", type=Path, metavar="PATH", help="Unix socket that takes commands to the emulated servos"
    )
    parser.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help=f"file with one of access.operate_tokens and nothing else; else it comes from {TOKEN_VARIABLE}",
    )
    parser.set_defaults(run=run_leader)


def _rate(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= MAX_RATE_HZ:
        raise argparse.ArgumentTypeError(f"must be a whole number from 1 to {MAX_RATE_HZ}, not {text!r}")
    return int(text)


def run_leader(options: argparse.Namespace) -> int:
    """Carry out the command."""
    # Imported when it is needed: --help answers without the server's libraries.
    from server.config_loader import load
    from server.teleop.leader_client import LeaderOptions, publish_leader

    terminal = Terminal()
    token = os.environ.get(TOKEN_VARIABLE)
    if options.token_file is not None:
        try:
            token = options.token_file.read_text().strip()
        except (OSError, ValueError) as error:
            terminal.say(f"armbridge: --token-file: {options.token_file} cannot be read: {error}")
            return ExitCode.USAGE
    given: dict[str, Any] = {
        "serial": options.serial,
        "robot": options.robot,
        "calibration": options.calibration,
        "joint_state_rate_hz": float(options.rate),
        "start_enabled": False,
    }
    emulator = {} if options.emulator_control is None else {"control": options.emulator_control}
    logs.configure("WARNING", "plain")
    if options.serial is not None and options.calibration is None:
        terminal.say("armbridge: --calibration: without one nobody knows where the joints of the leader are")
        return ExitCode.USAGE
    try:
        settings = load(
            None, {"arm": {key: value for key, value in given.items() if value is not None}, "emulator": emulator}
        )
        by_signal = asyncio.run(
            publish_leader(LeaderOptions(options.connect, options.topic, token), settings, terminal.say)
        )
    except ConfigurationError as error:
        terminal.say(f"armbridge: {error}")
        return ExitCode.USAGE
    return ExitCode.DONE if by_signal else ExitCode.FAILED
