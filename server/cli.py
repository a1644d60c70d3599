"""The command ``armbridge``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import metadata

from server.commands import calibrate, doctor, emulate, plan, relax, scan, serve
from server.commands.terminal import EXIT_CODES

# In the order in which someone with a new arm needs them.
COMMANDS = (serve, scan, calibrate, doctor, relax, plan, emulate)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    options = _parser().parse_args(arguments)
    code: int = options.run(options)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="armbridge",
        description="Drive an SO-101 robot arm from any rosbridge client, without ROS. A new arm: scan, calibrate, "
        "doctor, then serve.",
        epilog=f"{EXIT_CODES} armbridge COMMAND --help explains a command.",
    )
    parser.add_argument("--version", action="version", version=f"armbridge {metadata.version('armbridge')}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add_parser(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
