"""Pick up a small box and put it down elsewhere; the server: ``armbridge serve``, without physics (lift_a_block.py)."""

import argparse
import sys

from armbridge_client import ArmError, connect, pose  # pip install armbridge-client

SIZE_M = (0.025, 0.025, 0.05)
FROM, TO = (0.28, 0.1), (0.28, -0.1)  # x and y of the box before and after [m]
GRASP_HEIGHT_M, TRAVEL_HEIGHT_M = 0.04, 0.15
OPEN_RAD, CLOSED_RAD, FORCE = 1.2, 0.2, 0.3
FINGERS = ("gripper_link", "moving_jaw_so101_v1_link")


def main() -> None:
    """Add the box to the scene, grip it, carry it over and put it down."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    arguments = parser.parse_args()
    with connect(arguments.url) as arm:
        arm.scene.add_box("box", SIZE_M, pose(*FROM, SIZE_M[2] / 2))
        arm.gripper.move(OPEN_RAD, FORCE)
        arm.move_to(*FROM, TRAVEL_HEIGHT_M, speed=0.3)
        arm.scene.allow_contact("box", *FINGERS)
        arm.move_to(*FROM, GRASP_HEIGHT_M, speed=0.3)
        arm.gripper.move(CLOSED_RAD, FORCE)
        arm.scene.attach("box", touch_links=FINGERS)
        print("the box is held")
        for x, y, z in ((*FROM, TRAVEL_HEIGHT_M), (*TO, TRAVEL_HEIGHT_M), (*TO, GRASP_HEIGHT_M)):
            arm.move_to(x, y, z, speed=0.3)
        arm.gripper.move(OPEN_RAD, FORCE)
        arm.scene.detach("box")
        arm.move_to(*TO, TRAVEL_HEIGHT_M, speed=0.3)
        print("the box stands in its new place")


if __name__ == "__main__":
    try:
        main()
    except ArmError as error:
        sys.exit(str(error))
