"""Stack three cubes in physics, and see if the stack stands; the server: ``armbridge serve --simulation physics``."""

import argparse
import sys
import time

from armbridge_client import Arm, ArmError, connect, pose  # pip install ./clients/python

EDGE_M, MASS_KG = 0.025, 0.02
CUBES = {"bottom": (0.2, 0.0), "middle": (0.2, 0.1), "top": (0.2, -0.1)}  # x and y at the start [m]
START = {"shoulder_pan": 0.0, "shoulder_lift": -0.3, "elbow_flex": 0.22, "wrist_flex": 1.65, "wrist_roll": -1.57}
DOWN = (-(0.5**0.5), -(0.5**0.5), 0.0, 0.0)  # the fingers point down, and close along y
TRAVEL_M = 0.085  # of the tip; the wrist cannot point down from higher
GRIP_M = 0.014  # of the tip above the foot of the cube that it grips
BESIDE_M = 0.005  # between a cube and the fixed finger
OPEN_RAD, CLOSED_RAD, FORCE = 0.5, -0.1, 0.4
FINGERS = ("gripper_link", "moving_jaw_so101_v1_link")
SETTLED_S, NEAR_M = 1.0, 0.004


def follow(arm: Arm, *points: tuple[float, float, float]) -> None:
    """Move the tip along straight lines, the fingers down."""
    arm.plan_path([pose(*point, orientation=DOWN) for point in points], speed=0.3).execute()


def put(arm: Arm, name: str, to: tuple[float, float], foot_m: float) -> None:
    """Grip a cube, and put it down elsewhere, its foot at a height."""
    x, y = CUBES[name]
    beside = y + EDGE_M / 2 + BESIDE_M
    arm.gripper.move(OPEN_RAD, FORCE)
    follow(arm, (x, beside, TRAVEL_M), (x, beside, GRIP_M))
    if not arm.gripper.move(CLOSED_RAD, FORCE).holds:
        sys.exit(f"the fingers did not grip the {name} cube")
    arm.scene.attach(name, touch_links=FINGERS)
    # The cube is at the fixed finger now.
    x_to, held = to[0], to[1] + EDGE_M / 2
    follow(arm, (x, beside, TRAVEL_M), (x_to, held, TRAVEL_M), (x_to, held, foot_m + GRIP_M))
    arm.gripper.move(OPEN_RAD, FORCE)
    arm.scene.detach(name)
    follow(arm, (x_to, held + BESIDE_M, foot_m + GRIP_M), (x_to, held + BESIDE_M, TRAVEL_M))


def main() -> None:
    """Empty the scene, put the cubes there, stack them, and ask the physics for their poses."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    with connect(parser.parse_args().url) as arm:
        arm.scene.reset_physics()
        arm.move_joints(START, speed=0.3)
        for name, at in CUBES.items():
            arm.scene.add_box(name, (EDGE_M,) * 3, pose(*at, EDGE_M / 2))
            arm.scene.make_movable(name, mass_kg=MASS_KG)
        arm.scene.allow_contact(*CUBES, *FINGERS)
        for level, name in enumerate(("middle", "top"), 1):
            put(arm, name, CUBES["bottom"], level * EDGE_M)
            print(f"the {name} cube is put down")
        time.sleep(SETTLED_S)
        for level, (name, each) in enumerate((name, arm.scene.objects()[name]) for name in CUBES):
            height_m = each.pose.position.z - EDGE_M / 2
            if abs(height_m - level * EDGE_M) > NEAR_M:
                sys.exit(f"the stack fell: the {name} cube is {1000 * height_m:.0f} mm above the floor")
        print("the stack of three stands")


if __name__ == "__main__":
    try:
        main()
    except ArmError as error:
        sys.exit(str(error))
