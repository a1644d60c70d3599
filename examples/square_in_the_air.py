"""Draw a square in the air, 6 cm wide, with the tip on straight lines: ``python square_in_the_air.py [PORT]``."""

from __future__ import annotations

import copy
import sys
import threading
from typing import Any

import roslibpy

CONNECT_TIMEOUT_S = 5
ANSWER_TIMEOUT_S = 20
MOTION_TIMEOUT_S = 60

TIP = "gripper_frame_link"
SIDE_M = 0.06

# In front of the arm, with room on every side.
START = {"shoulder_pan": 0.0, "shoulder_lift": -0.5, "elbow_flex": 0.5, "wrist_flex": 0.0, "wrist_roll": 0.0}


def call(client: roslibpy.Ros, name: str, service_type: str, request: dict[str, Any]) -> dict[str, Any]:
    """Call a service; raises when it does not answer in time."""
    service = roslibpy.Service(client, name, service_type)
    return dict(service.call(roslibpy.ServiceRequest(request), timeout=ANSWER_TIMEOUT_S))


def act(client: roslibpy.Ros, name: str, action_type: str, goal: dict[str, Any]) -> dict[str, Any]:
    """Carry out an action and return its result; cancels it when it takes too long."""
    results: list[dict[str, Any]] = []
    ended = threading.Event()

    def take(result: Any) -> None:
        results.append(result)
        ended.set()

    action = roslibpy.ActionClient(client, name, action_type)
    goal_id = action.send_goal(roslibpy.Goal(goal), take, lambda _: None, take)
    if not ended.wait(MOTION_TIMEOUT_S):
        action.cancel_goal(goal_id)
        raise TimeoutError(f"{name}: no result within {MOTION_TIMEOUT_S} s")
    values = results[0]["values"]
    # A goal that is refused has a sentence for a result.
    return dict(values) if isinstance(values, dict) else sys.exit(str(values))


def check(code: dict[str, Any]) -> None:
    """End with the sentence when something could not be done."""
    if code["val"] != 1:
        sys.exit(f"{code['val']} {code['message']}")


def main(port: str = "9090") -> None:
    """Go to the start, plan the square as one path of the tip, and follow it."""
    client = roslibpy.Ros(host="127.0.0.1", port=int(port))
    client.run(timeout=CONNECT_TIMEOUT_S)
    try:
        joints = [{"joint_name": name, "position": angle} for name, angle in START.items()]
        request = {"group_name": "arm", "goal_constraints": [{"joint_constraints": joints}]}
        check(act(client, "/move_action", "moveit_msgs/action/MoveGroup", {"request": request})["error_code"])

        where = call(client, "/compute_fk", "moveit_msgs/srv/GetPositionFK", {"fk_link_names": [TIP]})
        corner = where["pose_stamped"][0]["pose"]
        corners = []
        for dy, dz in ((SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M), (0.0, 0.0)):
            pose = copy.deepcopy(corner)
            pose["position"]["y"] += dy
            pose["position"]["z"] += dz
            corners.append(pose)
        request = {"group_name": "arm", "link_name": TIP, "waypoints": corners, "max_step": 0.005}
        path = call(client, "/compute_cartesian_path", "moveit_msgs/srv/GetCartesianPath", request)
        check(path["error_code"])

        goal = {"trajectory": path["solution"]}
        check(act(client, "/execute_trajectory", "moveit_msgs/action/ExecuteTrajectory", goal)["error_code"])
        print(f"a square of {SIDE_M * 100:g} cm, {path['fraction']:.0%} of it")
    finally:
        client.terminate()


if __name__ == "__main__":
    main(*sys.argv[1:])
