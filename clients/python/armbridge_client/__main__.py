"""Command ``python -m armbridge_client``: shows, moves, watches and stops an arm from a shell."""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
from collections.abc import Sequence

from armbridge_client.arm import Arm, connect
from armbridge_client.errors import ArmError
from armbridge_client.targets import State, Target, pose

TARGET_HELP = "a name (ready), a position of the tip in metres (0.25 0 0.12), or joints (elbow_flex=0.5, in radians)"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns 0, or 1 with a sentence on standard error."""
    parser = argparse.ArgumentParser(
        prog="python -m armbridge_client", description="Shows, moves, watches and stops an arm."
    )
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    parser.add_argument("--arm", default="", help="name of the arm, on a server with several")
    # Behind the command as well, where many look for them first.
    server = argparse.ArgumentParser(add_help=False, argument_default=argparse.SUPPRESS)
    server.add_argument("--url", help="the server")
    server.add_argument("--arm", help="name of the arm, on a server with several")
    parser.epilog = "An authentication token is read from the environment variable ARMBRIDGE_TOKEN."
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("state", parents=[server], help="print mode, joint positions and the tip")
    move = commands.add_parser("move", parents=[server], help="move to a target")
    move.add_argument("target", nargs="+", type=str, help=TARGET_HELP)
    move.add_argument("--speed", type=float, default=0.0, help="share of the velocity limits, above 0 to 1")
    watch = commands.add_parser("watch", parents=[server], help="print joint positions until Ctrl-C")
    watch.add_argument("--rate", type=float, default=2.0, help="lines a second (default: %(default)s)")
    commands.add_parser("stop", parents=[server], help="stop the arm along its path")
    given = parser.parse_args(arguments)
    try:
        target = _target(given.target) if given.command == "move" else ""
        with connect(given.url, arm=given.arm) as arm:
            _run(arm, given, target)
    except (ArmError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    return 0


def _run(arm: Arm, given: argparse.Namespace, target: Target) -> None:
    match given.command:
        case "state":
            state, tip = arm.state(), arm.tip()
            at = tip.pose.position
            print(f"{state.mode}: {state.message}")
            print(_positions(state))
            print(f"tip {at.x:.3f} {at.y:.3f} {at.z:.3f} m in {tip.header.frame_id}")
        case "move":
            print(arm.move(target, speed=given.speed).message)
        case "watch":
            for state in arm.states(given.rate):
                print(state.mode, _positions(state), flush=True)
        case _:
            print(arm.stop())


def _positions(state: State) -> str:
    return " ".join(f"{joint}={position:.3f}" for joint, position in state.position_rad.items())


def _target(words: Sequence[str]) -> Target:
    with contextlib.suppress(ValueError):
        if all("=" in word for word in words):
            return {joint: float(position) for joint, _, position in (word.partition("=") for word in words)}
        if len(words) == 1:
            return words[0]
        if len(words) == 3:
            return pose(*(float(word) for word in words))
    raise ValueError(f"target must be {TARGET_HELP}, not {' '.join(words)}")


if __name__ == "__main__":
    sys.exit(main())
