"""Bring the tip to a point, or to the nearest reachable one; the server: ``armbridge serve``."""

import argparse
import sys

from armbridge_client import ArmError, GoalRefused, connect  # pip install ./clients/python


def main() -> None:
    """Move to the point or to the suggested one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    parser.add_argument("x", nargs="?", default=0.25, type=float, help="metres forward (default: %(default)s)")
    parser.add_argument("y", nargs="?", default=0.1, type=float, help="metres to the left (default: %(default)s)")
    parser.add_argument("z", nargs="?", default=0.2, type=float, help="metres up (default: %(default)s)")
    arguments = parser.parse_args()
    with connect(arguments.url) as arm:
        try:
            print(arm.move_to(arguments.x, arguments.y, arguments.z).message)
        except GoalRefused as refused:
            if refused.suggestion is None:
                raise
            print(refused.sentence)
            print(arm.move(refused.suggestion).message)


if __name__ == "__main__":
    try:
        main()
    except ArmError as error:
        sys.exit(str(error))
