"""Teach a push, and record it three times for a dataset, with the cameras of the physics.

The server: ``armbridge serve --simulation physics --record run.mcap``. Afterwards:
``armbridge export run.mcap --output pushes --fps 15``.
"""

import argparse
import sys

from armbridge_client import Arm, ArmError, connect, pose  # pip install ./clients/python

EPISODES, NAME, TASK = 3, "push", "push the block to the right"
SIZE_M, AT = (0.04, 0.04, 0.03), (0.2, 0.0)  # of the block, and its x and y [m]
HIGH = {"shoulder_lift": -0.456, "elbow_flex": 0.246, "wrist_flex": 1.6, "wrist_roll": -1.52}
LOW = {"shoulder_lift": -0.184, "elbow_flex": 0.628, "wrist_flex": 1.128, "wrist_roll": -1.52}
LEFT, RIGHT = {"shoulder_pan": -0.5}, {"shoulder_pan": 0.3}
FINGERS = ("gripper_link", "moving_jaw_so101_v1_link")


def put_block(arm: Arm) -> None:
    """Put the block to its place, wherever it was."""
    arm.scene.add_box("block", SIZE_M, pose(*AT, SIZE_M[2] / 2))
    arm.scene.make_movable("block")


def main() -> None:
    """Empty the scene, teach the motion by goals, and replay it as episodes, the block back in its place."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    with connect(parser.parse_args().url) as arm:
        arm.scene.reset_physics()
        arm.gripper.close()
        arm.move_joints(HIGH | LEFT, speed=0.3)
        put_block(arm)
        arm.scene.allow_contact("block", *FINGERS)
        if NAME in arm.teaching.names():
            arm.teaching.delete(NAME)
        arm.teaching.begin(NAME)
        for target in (LOW | LEFT, LOW | RIGHT, HIGH | RIGHT):
            arm.move_joints(target, speed=0.3)
        print(arm.teaching.end().message)
        for _ in range(EPISODES):
            arm.move_joints(HIGH | LEFT, speed=0.3)
            put_block(arm)
            arm.episodes.start(TASK)
            arm.teaching.replay(NAME)
            print(arm.episodes.stop())
            at = arm.scene.objects()["block"].pose.position
            print(f"the block stands at x {at.x:.2f}, y {at.y:.2f} m")


if __name__ == "__main__":
    try:
        main()
    except ArmError as error:
        sys.exit(str(error))
