"""Lift a block, carry it over and put it down; the server: ``armbridge serve --simulation physics``, or a real arm."""

import argparse
import sys
import time

from armbridge_client import Arm, ArmError, RequestRefused, connect, pose  # pip install ./clients/python

SIZE_M, MASS_KG = (0.025, 0.025, 0.05), 0.02
FROM = (0.2, -0.009)  # x and y of the block [m]
ABOVE = {"shoulder_pan": 0.0, "shoulder_lift": -0.456, "elbow_flex": 0.246, "wrist_flex": 1.6, "wrist_roll": -1.52}
AROUND = {"shoulder_pan": 0.0, "shoulder_lift": -0.184, "elbow_flex": 0.628, "wrist_flex": 1.128, "wrist_roll": -1.52}
ASIDE = {"shoulder_pan": 0.7}
OPEN_RAD, CLOSED_RAD, FORCE = 1.0, -0.1, 0.4
FINGERS = ("gripper_link", "moving_jaw_so101_v1_link")
SETTLED_S, LIFTED_M = 0.5, 0.05


def has_physics(arm: Arm) -> bool:
    """Let the physics move the block; return False if the server has none."""
    try:
        arm.scene.make_movable("block", mass_kg=MASS_KG)
    except RequestRefused:
        return False
    return True


def position(arm: Arm) -> tuple[float, float, float]:
    """Return x, y and the height of the block's foot once it is at rest [m], by the physics if there is one."""
    time.sleep(SETTLED_S)
    at = arm.scene.objects()["block"].pose.position
    return at.x, at.y, at.z - SIZE_M[2] / 2


def main() -> None:
    """Put the block there, grip it, lift it, carry it over and put it down."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    with connect(parser.parse_args().url) as arm:
        arm.scene.add_box("block", SIZE_M, pose(*FROM, SIZE_M[2] / 2))
        arm.scene.allow_contact("block", *FINGERS)
        physics = has_physics(arm)
        arm.gripper.move(OPEN_RAD, FORCE)
        for target in (ABOVE, AROUND):
            arm.move_joints(target, speed=0.3)
        grip = arm.gripper.move(CLOSED_RAD, FORCE)
        if physics:
            arm.move_joints(ABOVE, speed=0.3)
            lifted_m = position(arm)[2]
            print(f"by the physics the block is {1000 * lifted_m:.0f} mm above the floor")
            if lifted_m < LIFTED_M:
                sys.exit("the fingers did not lift the block")
        elif not grip.holds:
            print("nothing is lifted: the fingers closed on nothing, as they do without physics")
        arm.scene.attach("block", touch_links=FINGERS)
        for target in (ABOVE, ABOVE | ASIDE, AROUND | ASIDE):
            arm.move_joints(target, speed=0.3)
        arm.gripper.move(OPEN_RAD, FORCE)
        arm.scene.detach("block")
        arm.move_joints(ABOVE | ASIDE, speed=0.3)
        x, y, foot_m = position(arm)
        print(f"the block stands at x {x:.2f}, y {y:.2f} m, {round(1000 * foot_m)} mm above the floor")


if __name__ == "__main__":
    try:
        main()
    except ArmError as error:
        sys.exit(str(error))
