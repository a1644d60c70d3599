"""Bring the tip to a point, in metres: ``python pose_goal.py [X Y Z] [PORT]``; out of reach, to the nearest one."""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import roslibpy

CONNECT_TIMEOUT_S = 5
MOTION_TIMEOUT_S = 30


class Tip:
    """Goals for the tip, one after the other."""

    def __init__(self, client: roslibpy.Ros) -> None:
        self._status: dict[str, Any] = {}
        self._stamp = ""
        self._done = threading.Event()
        self._goals = roslibpy.Topic(client, "/moveit_goal_pose", "geometry_msgs/PoseStamped")
        news = roslibpy.Topic(client, "/moveit_goal_status", "diagnostic_msgs/DiagnosticStatus")
        news.subscribe(self._take_status)

    def move(self, position: dict[str, float]) -> tuple[bool, dict[str, float] | None]:
        """Go to a point of ``base_link`` [m]; tells whether the arm is there, and if not, which point would do."""
        seconds, nanoseconds = divmod(time.time_ns(), 10**9)
        self._stamp = f"{seconds}.{nanoseconds:09d}"
        self._done.clear()
        header = {"frame_id": "base_link", "stamp": {"sec": seconds, "nanosec": nanoseconds}}
        self._goals.publish(roslibpy.Message({"header": header, "pose": {"position": position}}))
        if not self._done.wait(MOTION_TIMEOUT_S):
            print(f"no answer within {MOTION_TIMEOUT_S} s")
            return False, None
        print(self._status["message"])
        values = {pair["key"]: pair["value"] for pair in self._status["values"]}
        suggested = json.loads(values.get("suggested_goal", "null"))
        return self._status["level"] == 0, suggested and suggested["msg"]["pose"]["position"]

    def _take_status(self, status: dict[str, Any]) -> None:
        values = {pair["key"]: pair["value"] for pair in status["values"]}
        if values["state"] == "done" and values.get("stamp") == self._stamp:
            self._status = status
            self._done.set()


def main(x: str = "0.25", y: str = "0.1", z: str = "0.2", port: str = "9090") -> int:
    """Go there, or where the server says it is possible; returns 0 when the arm has arrived."""
    client = roslibpy.Ros(host="127.0.0.1", port=int(port))
    client.run(timeout=CONNECT_TIMEOUT_S)
    tip = Tip(client)
    arrived, instead = tip.move({"x": float(x), "y": float(y), "z": float(z)})
    if instead is not None:
        arrived, _ = tip.move(instead)
    client.terminate()
    return 0 if arrived else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
