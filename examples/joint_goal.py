"""Turn some joints, in degrees, and watch the way: ``python joint_goal.py [PORT] [JOINT=DEGREES ...]``."""

from __future__ import annotations

import math
import sys
import threading
import time
from typing import Any

import roslibpy

CONNECT_TIMEOUT_S = 5
MOTION_TIMEOUT_S = 30


def main(port: str = "9090", *joints: str) -> int:
    """Send the goal, print how far it is, and return 0 when the arm is there."""
    client = roslibpy.Ros(host="127.0.0.1", port=int(port))
    client.run(timeout=CONNECT_TIMEOUT_S)

    # Every goal has a stamp of its own, which its news bring back: several clients may send goals.
    seconds, nanoseconds = divmod(time.time_ns(), 10**9)
    stamp = f"{seconds}.{nanoseconds:09d}"
    outcome: list[dict[str, Any]] = []
    done = threading.Event()

    def take_status(status: dict[str, Any]) -> None:
        values = {pair["key"]: pair["value"] for pair in status["values"]}
        if values.get("stamp") != stamp:
            return
        print(f"{values['state']:<10} {float(values['fraction']):4.0%}  {status['message']}")
        if values["state"] == "done":
            outcome.append(status)
            done.set()

    roslibpy.Topic(client, "/moveit_goal_status", "diagnostic_msgs/DiagnosticStatus").subscribe(take_status)
    asked = dict(joint.split("=") for joint in joints or ("shoulder_pan=20", "wrist_roll=-30"))
    goal = {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}},
        "name": list(asked),
        "position": [math.radians(float(degrees)) for degrees in asked.values()],
    }
    roslibpy.Topic(client, "/moveit_goal_joints", "sensor_msgs/JointState").publish(roslibpy.Message(goal))

    in_time = done.wait(MOTION_TIMEOUT_S)
    client.terminate()
    if not in_time:
        print(f"no answer within {MOTION_TIMEOUT_S} s")
    return 0 if in_time and outcome[0]["level"] == 0 else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
