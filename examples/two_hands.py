"""Move two arms at the same time, each by its name, then both together as one group.

The server: ``armbridge serve --config examples/two_arms.toml``.
"""

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor

from armbridge_client import Arm, ArmError, connect  # pip install ./clients/python


def turn(arm: Arm, angle_rad: float) -> None:
    """Turn an arm, and print its name and how the motion ended."""
    # Below the name of an arm, its joints are named without it.
    print(f"{arm.name}: {arm.move_joints({'shoulder_pan': angle_rad, 'elbow_flex': 0.4}).message}")


def main() -> None:
    """Move the arms, and print how each motion ended."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    arguments = parser.parse_args()
    with connect(arguments.url) as both, ThreadPoolExecutor() as threads:
        list(threads.map(turn, (both.other("left"), both.other("right")), (0.6, -0.6)))
        print(f"both: {both.move('home', group='both_arms').message}")


if __name__ == "__main__":
    try:
        main()
    except ArmError as error:
        sys.exit(str(error))
