"""Turn joints to angles in degrees and print the progress; the server: ``armbridge serve``."""

import argparse
import math
import sys
import threading
import time
from typing import Any

import roslibpy  # pip install roslibpy

CONNECT_TIMEOUT_S = 4
MOTION_TIMEOUT_S = 30

# Levels are those of diagnostic_msgs/DiagnosticStatus.
OK = 0


def connect(host: str, port: int) -> roslibpy.Ros:
    """Return a connection to the server, or end the program if no server answers."""
    client = roslibpy.Ros(host=host, port=port)
    try:
        client.run(timeout=CONNECT_TIMEOUT_S)
    except roslibpy.core.RosTimeoutError:
        sys.exit(f'no server answers at ws://{host}:{port}: start one with "make run"')
    return client


def joint_angle(text: str) -> tuple[str, float]:
    """Parse ``JOINT=DEGREES``; returns the joint's name and its angle [rad]."""
    name, _, degrees = text.partition("=")
    return name, math.radians(float(degrees))


def main() -> int:
    """Send the goal, print its progress, and return 0 if the arm has reached it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="name or address of the server (default: %(default)s)")
    parser.add_argument("--port", default=9090, type=int, help="port of the server (default: %(default)s)")
    joints_help = "a joint and its angle (default: shoulder_pan=20 wrist_roll=-30)"
    parser.add_argument("joints", nargs="*", type=joint_angle, metavar="JOINT=DEGREES", help=joints_help)
    arguments = parser.parse_args()
    angles = dict(arguments.joints or [joint_angle("shoulder_pan=20"), joint_angle("wrist_roll=-30")])
    client = connect(arguments.host, arguments.port)

    # Statuses of all clients' goals arrive on one topic; each repeats the stamp of its goal.
    seconds, nanoseconds = divmod(time.time_ns(), 10**9)
    stamp = f"{seconds}.{nanoseconds:09d}"
    final_statuses: list[dict[str, Any]] = []
    finished = threading.Event()

    def take_status(status: dict[str, Any]) -> None:
        values = {pair["key"]: pair["value"] for pair in status["values"]}
        if values.get("stamp") != stamp:
            return
        print(f"{values['state']:<10} {float(values['fraction']):4.0%}  {status['message']}")
        if values["state"] == "done":
            final_statuses.append(status)
            finished.set()

    # Subscribe first: a status published before the subscription would be missed.
    roslibpy.Topic(client, "/moveit_goal_status", "diagnostic_msgs/DiagnosticStatus").subscribe(take_status)
    header = {"stamp": {"sec": seconds, "nanosec": nanoseconds}}
    goal = roslibpy.Message({"header": header, "name": list(angles), "position": list(angles.values())})
    roslibpy.Topic(client, "/moveit_goal_joints", "sensor_msgs/JointState").publish(goal)

    in_time = finished.wait(MOTION_TIMEOUT_S)
    client.terminate()
    if not in_time:
        print(f"no result within {MOTION_TIMEOUT_S} s")
    return 0 if in_time and final_statuses[0]["level"] == OK else 1


if __name__ == "__main__":
    sys.exit(main())
