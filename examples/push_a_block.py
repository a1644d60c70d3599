"""Push a block to a mark in physics, looking after each push; the server: ``armbridge serve --simulation physics``."""

import argparse
import math
import sys
import time

from armbridge_client import Arm, ArmError, connect, pose  # pip install ./clients/python

SIZE_M, MASS_KG = (0.04, 0.04, 0.03), 0.05
FROM, MARK = (0.22, -0.06), (0.2, 0.06)  # x and y of the block, and of the mark [m]
START = {"shoulder_pan": -0.3, "shoulder_lift": -0.3, "elbow_flex": 0.22, "wrist_flex": 1.65, "wrist_roll": -1.57}
TRAVEL_M, PUSH_M = 0.08, 0.014  # heights of the tip
FINGER_M = 0.025  # from the tip to the outer side of the fixed finger, at most
GAP_M = 0.015  # between finger and block at the start of a push
FINGERS = ("gripper_link", "moving_jaw_so101_v1_link")
MOST_PUSHES, NEAR_M, SETTLED_S = 4, 0.003, 0.5


def position(arm: Arm) -> tuple[float, float]:
    """Return x and y of the block by the physics, once it is at rest [m]."""
    time.sleep(SETTLED_S)
    at = arm.scene.objects()["block"].pose.position
    return at.x, at.y


def push(arm: Arm, at: tuple[float, float], behind_m: float) -> tuple[float, float]:
    """Push the block straight towards the mark, until the tip is ``behind_m`` before it; return x and y there [m]."""
    turn = math.atan2(MARK[1] - at[1], MARK[0] - at[0])
    x, y = math.cos(turn), math.sin(turn)
    # The fingers point down, the outer side of the fixed finger towards the mark.
    down = (-math.cos(0.5 * turn), -math.sin(0.5 * turn), 0.0, 0.0)
    before_m = SIZE_M[0] / 2 + FINGER_M + GAP_M
    begin, end = (at[0] - before_m * x, at[1] - before_m * y), (MARK[0] - behind_m * x, MARK[1] - behind_m * y)
    points = ((*begin, TRAVEL_M), (*begin, PUSH_M), (*end, PUSH_M), (*begin, PUSH_M), (*begin, TRAVEL_M))
    arm.plan_path([pose(*point, orientation=down) for point in points], speed=0.3).execute()
    return end


def main() -> None:
    """Empty the scene, put the block there, and push it until it is at the mark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    with connect(parser.parse_args().url) as arm:
        arm.scene.reset_physics()
        arm.gripper.close()
        arm.move_joints(START, speed=0.3)
        arm.scene.add_box("block", SIZE_M, pose(*FROM, SIZE_M[2] / 2))
        arm.scene.make_movable("block", mass_kg=MASS_KG)
        arm.scene.allow_contact("block", *FINGERS)
        at, behind_m = position(arm), SIZE_M[0] / 2 + FINGER_M
        for _ in range(MOST_PUSHES):
            tip = push(arm, at, behind_m)
            at = position(arm)
            # The first push ends short of the mark, and shows how far from the tip the finger touches the block.
            behind_m = math.dist(tip, at)
            left_m = math.dist(at, MARK)
            print(f"the block is {1000 * left_m:.1f} mm from the mark")
            if left_m < NEAR_M:
                return
        sys.exit(f"the block is not at the mark after {MOST_PUSHES} pushes")


if __name__ == "__main__":
    try:
        main()
    except ArmError as error:
        sys.exit(str(error))
