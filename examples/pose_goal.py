"""Bring the tip to a point, or to the nearest reachable one; the server: ``armbridge serve``."""

import argparse
import json
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


class PoseGoals:
    """Goals for the tip, one after the other."""

    def __init__(self, client: roslibpy.Ros) -> None:
        self._status: dict[str, Any] = {}
        self._stamp = ""
        self._finished = threading.Event()
        self._goals = roslibpy.Topic(client, "/moveit_goal_pose", "geometry_msgs/PoseStamped")
        statuses = roslibpy.Topic(client, "/moveit_goal_status", "diagnostic_msgs/DiagnosticStatus")
        statuses.subscribe(self._take_status)

    def send(self, position: dict[str, float]) -> tuple[bool, dict[str, float] | None]:
        """Move the tip to a point of ``base_link`` [m]; returns success, and the point that the server suggests."""
        seconds, nanoseconds = divmod(time.time_ns(), 10**9)
        self._stamp = f"{seconds}.{nanoseconds:09d}"
        self._finished.clear()
        header = {"frame_id": "base_link", "stamp": {"sec": seconds, "nanosec": nanoseconds}}
        # The position alone is the goal: five joints cannot reach any orientation as well.
        self._goals.publish(roslibpy.Message({"header": header, "pose": {"position": position}}))
        if not self._finished.wait(MOTION_TIMEOUT_S):
            print(f"no result within {MOTION_TIMEOUT_S} s")
            return False, None
        print(self._status["message"])
        values = {pair["key"]: pair["value"] for pair in self._status["values"]}
        # Each value is a text; a suggested goal is JSON: {"topic": ..., "msg": ...}.
        suggested = json.loads(values.get("suggested_goal", "null"))
        return self._status["level"] == OK, suggested and suggested["msg"]["pose"]["position"]

    def _take_status(self, status: dict[str, Any]) -> None:
        # Statuses of all clients' goals arrive on one topic; each repeats the stamp of its goal.
        values = {pair["key"]: pair["value"] for pair in status["values"]}
        if values["state"] == "done" and values.get("stamp") == self._stamp:
            self._status = status
            self._finished.set()


def main() -> int:
    """Move the tip to the point or to the suggested one, and return 0 if the arm has reached it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="name or address of the server (default: %(default)s)")
    parser.add_argument("--port", default=9090, type=int, help="port of the server (default: %(default)s)")
    parser.add_argument(
        "x", nargs="?", default=0.25, type=float, help="metres forward from the base (default: %(default)s)"
    )
    parser.add_argument("y", nargs="?", default=0.1, type=float, help="metres to the left (default: %(default)s)")
    parser.add_argument("z", nargs="?", default=0.2, type=float, help="metres up (default: %(default)s)")
    arguments = parser.parse_args()
    client = connect(arguments.host, arguments.port)

    goals = PoseGoals(client)
    reached, suggested = goals.send({"x": arguments.x, "y": arguments.y, "z": arguments.z})
    if suggested is not None:
        reached, _ = goals.send(suggested)
    client.terminate()
    return 0 if reached else 1


if __name__ == "__main__":
    sys.exit(main())
