"""Turn joints to angles in degrees and print the progress; the server: ``armbridge serve``."""

import argparse
import math
import sys

from armbridge_client import ArmError, connect  # pip install ./clients/python


def joint_angle(text: str) -> tuple[str, float]:
    """Parse ``JOINT=DEGREES``; returns the joint's name and its angle [rad]."""
    name, _, degrees = text.partition("=")
    try:
        return name, math.radians(float(degrees))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no JOINT=DEGREES, as in shoulder_pan=20") from None


def main() -> None:
    """Move, and print each report of the server."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    joints_help = "a joint and its angle (default: shoulder_pan=20 wrist_roll=-30)"
    parser.add_argument("joints", nargs="*", type=joint_angle, metavar="JOINT=DEGREES", help=joints_help)
    arguments = parser.parse_args()
    angles = dict(arguments.joints or [joint_angle("shoulder_pan=20"), joint_angle("wrist_roll=-30")])
    with connect(arguments.url) as arm:
        arm.move(angles, on_progress=lambda now: print(f"{now.state:<10} {now.fraction:4.0%}  {now.message}"))


if __name__ == "__main__":
    try:
        main()
    except ArmError as error:
        sys.exit(str(error))
