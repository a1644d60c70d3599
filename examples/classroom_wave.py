"""Wave between two points until Ctrl-C, then stop the arm; the server: ``armbridge serve``."""

import argparse
import queue
import signal
import sys
import threading
import time
from typing import Any

import roslibpy  # pip install roslibpy

CONNECT_TIMEOUT_S = 4
MOTION_TIMEOUT_S = 30
STOP_TIMEOUT_S = 5
RETRY_PAUSE_S = 1
# Result codes are those of moveit_msgs/MoveItErrorCodes.
SUCCESS = 1
NAMES = {-1: "PLANNING_FAILED", -4: "CONTROL_FAILED", -6: "TIMED_OUT", -7: "PREEMPTED", -12: "GOAL_IN_COLLISION"}
NAMES |= {-16: "INVALID_GOAL_CONSTRAINTS", -25: "COMMUNICATION_FAILURE", -31: "NO_IK_SOLUTION", 99999: "FAILURE"}
SPHERE = 2  # shape_msgs/SolidPrimitive


def connect(host: str, port: int) -> roslibpy.Ros:
    """Return a connection to the server, or end the program if no server answers."""
    client = roslibpy.Ros(host=host, port=port)
    try:
        client.run(timeout=CONNECT_TIMEOUT_S)
    except roslibpy.core.RosTimeoutError:
        sys.exit(f'no server answers at ws://{host}:{port}: start one with "make run"')
    return client


class Arm:
    """An arm that moves its tip until ``ending`` is set."""

    def __init__(self, client: roslibpy.Ros) -> None:
        self._action = roslibpy.ActionClient(client, "/move_action", "moveit_msgs/action/MoveGroup")
        self._stop = roslibpy.Service(client, "/arm/stop", "std_srvs/srv/Trigger")
        self.ending = threading.Event()

    def move_tip(self, x: float, y: float, z: float) -> str | None:
        """Move the tip to a point of ``base_link`` [m]; returns None on success, else the name of the error."""
        pose = {"position": {"x": x, "y": y, "z": z}, "orientation": {"w": 1.0}}
        region = {"primitives": [{"type": SPHERE, "dimensions": [0.01]}], "primitive_poses": [pose]}
        place = {"header": {"frame_id": "base_link"}, "link_name": "gripper_frame_link", "constraint_region": region}
        goals = [{"position_constraints": [place]}]
        goal = roslibpy.Goal({"request": {"max_velocity_scaling_factor": 0.3, "goal_constraints": goals}})
        results: queue.Queue[Any] = queue.Queue()
        goal_id = self._action.send_goal(goal, results.put, lambda _: None, results.put)
        deadline_s = time.monotonic() + MOTION_TIMEOUT_S
        while not self.ending.is_set() and time.monotonic() < deadline_s:
            try:
                values = results.get(timeout=0.1)["values"]
            except queue.Empty:
                continue
            if isinstance(values, str):
                # The result of a rejected goal is a sentence, for instance while another client controls the arm.
                print(values, flush=True)
                return "FAILURE"
            code = values["error_code"]["val"]
            return None if code == SUCCESS else NAMES.get(code, f"error {code}")
        self._action.cancel_goal(goal_id)
        return "PREEMPTED" if self.ending.is_set() else "TIMED_OUT"

    def stop(self) -> None:
        """Stop the arm along its path and end every client's goals; returns when the arm stands still."""
        try:
            print(self._stop.call(roslibpy.ServiceRequest(), timeout=STOP_TIMEOUT_S)["message"])
        except (roslibpy.core.RosTimeoutError, roslibpy.core.ServiceException) as error:
            sys.exit(f"the arm may still move: /arm/stop: {error}")


def main() -> None:
    """Wave until a signal comes, then stop the arm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="name or address of the server (default: %(default)s)")
    parser.add_argument("--port", default=9090, type=int, help="port of the server (default: %(default)s)")
    arguments = parser.parse_args()
    client = connect(arguments.host, arguments.port)
    arm = Arm(client)
    # Registered before the first goal: a Ctrl-C in between must not leave the arm moving.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: arm.ending.set())
    try:
        while not arm.ending.is_set():
            for point in ((0.25, 0.12, 0.2), (0.25, -0.12, 0.2)):
                error = None if arm.ending.is_set() else arm.move_tip(*point)
                print(error or "there", flush=True)
                if error:
                    arm.ending.wait(RETRY_PAUSE_S)
    finally:
        try:
            arm.stop()
        finally:
            client.terminate()


if __name__ == "__main__":
    main()
