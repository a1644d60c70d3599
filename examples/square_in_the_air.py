"""Draw a square in the air with the tip, along straight lines; the server: ``armbridge serve``."""

import argparse
import sys

from armbridge_client import ArmError, connect, pose  # pip install ./clients/python

SIDE_M = 0.06
# In front of the arm, with room on every side [rad].
START = {"shoulder_pan": 0.0, "shoulder_lift": -0.5, "elbow_flex": 0.5, "wrist_flex": 0.0, "wrist_roll": 0.0}


def main() -> None:
    """Move to the start, plan the square as one path of the tip, and follow it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    arguments = parser.parse_args()
    with connect(arguments.url) as arm:
        arm.move_joints(START, speed=0.3)
        tip = arm.tip().pose
        corners = ((SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M), (0.0, 0.0))
        path = [pose(tip.position.x, tip.position.y + dy, tip.position.z + dz) for dy, dz in corners]
        for corner in path:
            corner.pose.orientation = tip.orientation
        arm.plan_path(path).execute()
        print(f"a square of {SIDE_M * 100:g} cm")


if __name__ == "__main__":
    try:
        main()
    except ArmError as error:
        sys.exit(str(error))
