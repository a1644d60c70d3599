"""Wave with a Fetch's hand until Ctrl-C, token in ARMBRIDGE_TOKEN; the server: ``armbridge serve --robot fetch``."""

import argparse
import itertools
import os
import queue
import signal
import sys
import threading
import time
from typing import Any

import roslibpy  # pip install roslibpy

CONNECT_TIMEOUT_S = 4
MOTION_TIMEOUT_S = 30
RETRY_PAUSE_S = 1
TOLERANCE = 0.01  # [m], and [rad] about each axis
# Result codes of moveit_msgs/MoveItErrorCodes.
NAMES = {1: "SUCCESS", -1: "PLANNING_FAILED", -4: "CONTROL_FAILED", -7: "PREEMPTED"}
NAMES |= {-12: "GOAL_IN_COLLISION", -16: "INVALID_GOAL_CONSTRAINTS", -31: "NO_IK_SOLUTION", 99999: "FAILURE"}
# Positions in base_link [m], and the hand's orientation at both: fingers forward and up.
POSITIONS = ((0.55, 0.3, 1.15), (0.55, -0.3, 1.15))
ORIENTATION = (0.0, -0.3827, 0.0, 0.9239)


class Arm:
    """The action ``/move_group`` by actionlib's topics."""

    def __init__(self, client: roslibpy.Ros) -> None:
        self.ending = threading.Event()
        self._results: queue.Queue[Any] = queue.Queue()
        self._goals = roslibpy.Topic(client, "/move_group/goal", "moveit_msgs/MoveGroupActionGoal")
        self._cancels = roslibpy.Topic(client, "/move_group/cancel", "actionlib_msgs/GoalID")
        result = roslibpy.Topic(client, "/move_group/result", "moveit_msgs/MoveGroupActionResult")
        result.subscribe(self._results.put)

    def move(self, position: tuple[float, ...], orientation: tuple[float, ...]) -> str:
        """Move the hand to a pose; returns the name of the result."""
        goal_id = {"id": f"wave-{time.monotonic_ns()}"}
        request = {"group_name": "arm", "goal_constraints": [constraints(position, orientation)]}
        self._goals.publish(roslibpy.Message({"goal_id": goal_id, "goal": {"request": request}}))
        deadline_s = time.monotonic() + MOTION_TIMEOUT_S
        while not self.ending.is_set() and time.monotonic() < deadline_s:
            try:
                result = self._results.get(timeout=0.1)
            except queue.Empty:
                continue
            if result["status"]["goal_id"]["id"] == goal_id["id"]:
                code = result["result"]["error_code"]["val"]
                return NAMES.get(code, f"error {code}")
        self._cancels.publish(roslibpy.Message(goal_id))
        return "PREEMPTED" if self.ending.is_set() else "TIMED_OUT"

    def cancel_all(self) -> None:
        """End all goals: a GoalID without id and stamp means every one."""
        self._cancels.publish(roslibpy.Message({"stamp": {"secs": 0, "nsecs": 0}, "id": ""}))
        time.sleep(RETRY_PAUSE_S)  # the message leaves meanwhile


def constraints(position: tuple[float, ...], orientation: tuple[float, ...]) -> dict[str, Any]:
    """Return the moveit_msgs/Constraints of a pose of the hand."""
    hand = {"header": {"frame_id": "base_link"}, "link_name": "gripper_link", "weight": 1.0}
    pose = {"position": dict(zip("xyz", position, strict=True)), "orientation": {"w": 1.0}}
    region = {"primitives": [{"type": 2, "dimensions": [TOLERANCE]}], "primitive_poses": [pose]}  # 2 is a sphere
    turn = {f"absolute_{axis}_axis_tolerance": TOLERANCE for axis in "xyz"}
    turn["orientation"] = dict(zip("xyzw", orientation, strict=True))
    return {"position_constraints": [hand | {"constraint_region": region}], "orientation_constraints": [hand | turn]}


def main() -> None:
    """Wave until a signal comes, then cancel every goal."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    arguments = parser.parse_args()
    token = os.environ.get("ARMBRIDGE_TOKEN")
    headers = {"Authorization": f"Bearer {token}"} if token else None
    client = roslibpy.Ros(arguments.url, headers=headers)
    try:
        client.run(timeout=CONNECT_TIMEOUT_S)
    except roslibpy.core.RosTimeoutError:
        sys.exit(f"no server answers at {arguments.url}: start one with armbridge serve")
    arm = Arm(client)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: arm.ending.set())
    try:
        for position in itertools.takewhile(lambda _: not arm.ending.is_set(), itertools.cycle(POSITIONS)):
            print(name := arm.move(position, ORIENTATION), flush=True)
            if name in ("NO_IK_SOLUTION", "error -15", "error -18"):  # no such pose, group or link
                sys.exit("this arm is no Fetch: start one with armbridge serve --robot fetch")
            if name != "SUCCESS":
                arm.ending.wait(RETRY_PAUSE_S)
    finally:
        arm.cancel_all()
        client.terminate()


if __name__ == "__main__":
    main()
