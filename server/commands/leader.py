"""``armbridge leader``: a relaxed arm at this machine, as the leader of an arm at a server elsewhere."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path
from typing import Any

from robot import logs
from server.commands.options import (
    CALIBRATION_HELP,
    SERIAL_HELP,
    Subparsers,
    add_command,
    add_connect,
    add_robot,
    add_token_file,
    number,
    read_token,
)
from server.commands.terminal import ExitCode, Terminal
from server.errors import ConfigurationError

DEFAULT_TOPIC = "/leader/joint_states"
DEFAULT_RATE_HZ, MAX_RATE_HZ = 100, 100


def add_leader_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = add_command(
        subparsers,
        "leader",
        _stream,
        "stream a relaxed arm to a server, whose arm follows it",
        "Read an arm that is moved by hand, and publish its joints on a running server, whose arm follows "
        "them after /teleop/start with this topic as its leader (docs/teleoperation.md). The arm never gets torque. It "
        "connects again when the server comes back, and ends with Ctrl+C. Without --serial the arm is emulated.",
    )
    add_connect(parser)
    parser.add_argument("--serial", metavar="PORT", help=f"{SERIAL_HELP} (an emulated arm)")
    add_robot(parser, None)
    parser.add_argument("--calibration", metavar="NAME_OR_PATH", help=CALIBRATION_HELP)
    parser.add_argument("--topic", default=DEFAULT_TOPIC, help=f"of the joints ({DEFAULT_TOPIC})")
    parser.add_argument(
        "--rate",
        type=number(int, 1, MAX_RATE_HZ),
        default=DEFAULT_RATE_HZ,
        metavar="HZ",
        help=f"samples a second ({DEFAULT_RATE_HZ})",
    )
    parser.add_argument(
        "--emulator-control", type=Path, metavar="PATH", help="Unix socket that takes commands to the emulated servos"
    )
    add_token_file(parser, "access.operate_tokens")


def _stream(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.config_loader import load
    from server.publishing_client import PublishedTopic
    from server.teleop.leader_client import publish_leader

    token = read_token(options)
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
        raise ConfigurationError("--calibration: without one nobody knows where the joints of the leader are")
    settings = load(
        None, {"arm": {key: value for key, value in given.items() if value is not None}, "emulator": emulator}
    )
    target = PublishedTopic(options.connect, options.topic, token)
    by_signal = asyncio.run(publish_leader(target, settings, terminal.say))
    return ExitCode.DONE if by_signal else ExitCode.FAILED
