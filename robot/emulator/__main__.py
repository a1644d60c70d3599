"""``python -m robot.emulator``: run the emulated servo bus of an SO-101 on a pseudo terminal."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from robot.emulator import control
from robot.emulator.process import add_options, run
from robot.errors import CalibrationError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the emulator and return the exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        run(options, options.control_fd)
    except (CalibrationError, ValueError, OSError) as error:
        parser.error(str(error))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m robot.emulator",
        description="Emulate the servo bus of an SO-101 on a pseudo terminal and print the terminal's path.",
        epilog=f"The control socket or standard input takes:\n\n{control.COMMANDS_HELP}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_options(parser)
    parser.add_argument(
        "--control-fd",
        type=int,
        metavar="N",
        help="inherited socket: announce the port there, take live commands, end when the other side is gone",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
