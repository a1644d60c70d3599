"""Wave between two poses until Ctrl-C: ``python classroom_wave.py [PORT]``.

Start from ``move_to_pose``: it waits for the arm and returns None, or the name of the error.
"""

from __future__ import annotations

import queue
import signal
import sys
import threading
import time
from typing import Any

import roslibpy

CONNECT_TIMEOUT_S = 5
MOTION_TIMEOUT_S = 30
STOP_TIMEOUT_S = 5
RETRY_PAUSE_S = 1

NAMES = {-1: "PLANNING_FAILED", -4: "CONTROL_FAILED", -6: "TIMED_OUT", -7: "PREEMPTED", -12: "GOAL_IN_COLLISION"}
NAMES |= {-16: "INVALID_GOAL_CONSTRAINTS", -25: "COMMUNICATION_FAILURE", -31: "NO_IK_SOLUTION", 99999: "FAILURE"}


class Arm:
    """An arm that moves its tip."""

    def __init__(self, client: roslibpy.Ros) -> None:
        self._action = roslibpy.ActionClient(client, "/move_action", "moveit_msgs/action/MoveGroup")
        self._stop = roslibpy.Service(client, "/arm/stop", "std_srvs/srv/Trigger")
        self.ending = threading.Event()

    def move_to_pose(self, pose_stamped: dict[str, Any]) -> str | None:
        """Bring the tip to a position; returns None when it is there, else the name of the error."""
        place = {"header": pose_stamped["header"], "link_name": "gripper_frame_link"}
        ball = {"primitives": [{"type": 2, "dimensions": [0.01]}], "primitive_poses": [pose_stamped["pose"]]}
        goal = {"request": {"goal_constraints": [{"position_constraints": [{**place, "constraint_region": ball}]}]}}
        results: queue.Queue[Any] = queue.Queue()
        goal_id = self._action.send_goal(roslibpy.Goal(goal), results.put, lambda _: None, results.put)
        until_s = time.monotonic() + MOTION_TIMEOUT_S
        while not self.ending.is_set() and time.monotonic() < until_s:
            try:
                values = results.get(timeout=0.1)["values"]
            except queue.Empty:
                continue
            if isinstance(values, str):
                # Refused, for instance while another client drives: a sentence says why.
                print(values, flush=True)
                return "FAILURE"
            number = values["error_code"]["val"]
            return None if number == 1 else NAMES.get(number, f"error {number}")
        self._action.cancel_goal(goal_id)
        return "PREEMPTED" if self.ending.is_set() else "TIMED_OUT"

    def cancel_all_goals(self) -> None:
        """Stop the arm along its path and end every goal, also those of others; returns when it stands."""
        print(self._stop.call(roslibpy.ServiceRequest(), timeout=STOP_TIMEOUT_S)["message"])


def pose(x: float, y: float, z: float) -> dict[str, Any]:
    """A point of the arm's base [m] as a geometry_msgs/PoseStamped."""
    position = {"x": x, "y": y, "z": z}
    return {"header": {"frame_id": "base_link"}, "pose": {"position": position, "orientation": {"w": 1.0}}}


def main(port: str = "9090") -> None:
    """Wave until a signal comes, then leave the arm standing."""
    client = roslibpy.Ros(host="127.0.0.1", port=int(port))
    client.run(timeout=CONNECT_TIMEOUT_S)
    arm = Arm(client)
    # Before the first goal: a Ctrl-C in between must not leave the arm moving.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: arm.ending.set())
    try:
        while not arm.ending.is_set():
            for target in (pose(0.25, 0.12, 0.2), pose(0.25, -0.12, 0.2)):
                error = None if arm.ending.is_set() else arm.move_to_pose(target)
                print(error or "there", flush=True)
                if error:
                    arm.ending.wait(RETRY_PAUSE_S)
    finally:
        try:
            arm.cancel_all_goals()
        finally:
            client.terminate()


if __name__ == "__main__":
    main(*sys.argv[1:])
