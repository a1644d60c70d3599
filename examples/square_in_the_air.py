"""Draw a square in the air with the tip, along straight lines; the server: ``armbridge serve``."""

import argparse
import copy
import queue
import sys
from typing import Any

import roslibpy  # pip install roslibpy

CONNECT_TIMEOUT_S = 4
ANSWER_TIMEOUT_S = 20
MOTION_TIMEOUT_S = 60

TIP = "gripper_frame_link"
SIDE_M = 0.06
# In front of the arm, with room on every side [rad].
START = {"shoulder_pan": 0.0, "shoulder_lift": -0.5, "elbow_flex": 0.5, "wrist_flex": 0.0, "wrist_roll": 0.0}
SUCCESS = 1  # of moveit_msgs/MoveItErrorCodes


def connect(host: str, port: int) -> roslibpy.Ros:
    """Return a connection to the server, or end the program if no server answers."""
    client = roslibpy.Ros(host=host, port=port)
    try:
        client.run(timeout=CONNECT_TIMEOUT_S)
    except roslibpy.core.RosTimeoutError:
        sys.exit(f'no server answers at ws://{host}:{port}: start one with "make run"')
    return client


def check(name: str, code: dict[str, Any]) -> None:
    """End the program with the error's sentence unless the code is success."""
    if code["val"] != SUCCESS:
        sys.exit(f"{name}: {code['val']} {code['message']}")


def call_service(client: roslibpy.Ros, name: str, service_type: str, request: dict[str, Any]) -> dict[str, Any]:
    """Call a service that reports an ``error_code``, and return its response."""
    service = roslibpy.Service(client, name, service_type)
    try:
        response = service.call(roslibpy.ServiceRequest(request), timeout=ANSWER_TIMEOUT_S)
    except (roslibpy.core.RosTimeoutError, roslibpy.core.ServiceException) as error:
        sys.exit(f"{name}: {error}")
    check(name, response["error_code"])
    return dict(response)


def send_goal(client: roslibpy.Ros, name: str, action_type: str, goal: dict[str, Any]) -> None:
    """Send a goal to an action and wait for success; cancels it when it takes too long."""
    results: queue.Queue[Any] = queue.Queue()
    action = roslibpy.ActionClient(client, name, action_type)
    goal_id = action.send_goal(roslibpy.Goal(goal), results.put, lambda _: None, results.put)
    try:
        values = results.get(timeout=MOTION_TIMEOUT_S)["values"]
    except queue.Empty:
        action.cancel_goal(goal_id)
        sys.exit(f"{name}: no result within {MOTION_TIMEOUT_S} s")
    if not isinstance(values, dict):  # a rejected goal's result is a sentence
        sys.exit(f"{name}: {values}")
    check(name, values["error_code"])


def draw(client: roslibpy.Ros) -> None:
    """Move to the start, plan the square as one path of the tip, and follow it."""
    goals = [{"joint_constraints": [{"joint_name": name, "position": angle} for name, angle in START.items()]}]
    start = {"group_name": "arm", "max_velocity_scaling_factor": 0.3, "goal_constraints": goals}
    send_goal(client, "/move_action", "moveit_msgs/action/MoveGroup", {"request": start})

    tip = call_service(client, "/compute_fk", "moveit_msgs/srv/GetPositionFK", {"fk_link_names": [TIP]})
    corners = []
    for dy, dz in ((SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M), (0.0, 0.0)):
        corner = copy.deepcopy(tip["pose_stamped"][0]["pose"])
        corner["position"]["y"] += dy
        corner["position"]["z"] += dz
        corners.append(corner)
    request = {"group_name": "arm", "link_name": TIP, "waypoints": corners, "max_step": 0.005}
    path = call_service(client, "/compute_cartesian_path", "moveit_msgs/srv/GetCartesianPath", request)
    if path["fraction"] < 1.0:
        sys.exit(f"only {path['fraction']:.0%} of the square can be drawn: {path['error_code']['message']}")
    square = {"trajectory": path["solution"]}
    send_goal(client, "/execute_trajectory", "moveit_msgs/action/ExecuteTrajectory", square)
    print(f"a square of {SIDE_M * 100:g} cm")


def main() -> None:
    """Connect, draw the square, disconnect."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="name or address of the server (default: %(default)s)")
    parser.add_argument("--port", default=9090, type=int, help="port of the server (default: %(default)s)")
    arguments = parser.parse_args()
    client = connect(arguments.host, arguments.port)
    try:
        draw(client)
    finally:
        client.terminate()


if __name__ == "__main__":
    main()
