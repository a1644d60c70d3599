"""Pick up a small box and put it down elsewhere: ``python pick_and_place.py [PORT]``."""

from __future__ import annotations

import queue
import sys
from typing import Any

import roslibpy

CONNECT_TIMEOUT_S = 5
ANSWER_TIMEOUT_S = 10
ACTION_TIMEOUT_S = 60

SIZE_M = [0.025, 0.025, 0.05]
FROM = (0.28, 0.1)
TO = (0.28, -0.1)
GRASP_HEIGHT_M = 0.04
TRAVEL_HEIGHT_M = 0.15
OPEN_RAD, CLOSED_RAD = 1.2, 0.2
FINGERS = ["gripper_link", "moving_jaw_so101_v1_link"]


class Arm:
    """What picking and placing needs; whatever fails ends the program with its sentence."""

    def __init__(self, client: roslibpy.Ros) -> None:
        self._client = client

    def change_scene(self, change: dict[str, Any]) -> None:
        """Apply a change (moveit_msgs/PlanningScene) to the planning scene."""
        service = roslibpy.Service(self._client, "/apply_planning_scene", "moveit_msgs/srv/ApplyPlanningScene")
        scene = {"is_diff": True, "robot_state": {"is_diff": True}, **change}
        if not service.call(roslibpy.ServiceRequest({"scene": scene}), timeout=ANSWER_TIMEOUT_S)["success"]:
            sys.exit(f"the scene was not changed; the server's log says why: {change}")

    def move_tip(self, x: float, y: float, z: float) -> None:
        """Bring the tip to a point of ``base_link`` [m]."""
        pose = {"position": {"x": x, "y": y, "z": z}, "orientation": {"w": 1.0}}
        ball = {"primitives": [{"type": 2, "dimensions": [0.005]}], "primitive_poses": [pose]}
        place = {"link_name": "gripper_frame_link", "constraint_region": ball, "header": {"frame_id": "base_link"}}
        request = {"goal_constraints": [{"position_constraints": [place]}]}
        code = self._act("/move_action", "moveit_msgs/action/MoveGroup", {"request": request})["error_code"]
        if code["val"] != 1:
            sys.exit(f"to ({x}, {y}, {z}): {code['val']} {code['message']}")

    def move_gripper(self, position: float) -> None:
        """Open or close the gripper to an angle [rad]; one that meets something grips it."""
        goal = {"command": {"position": position, "max_effort": 0.3}}
        self._act("/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand", goal)

    def _act(self, name: str, action_type: str, goal: dict[str, Any]) -> dict[str, Any]:
        results: queue.Queue[Any] = queue.Queue()
        action = roslibpy.ActionClient(self._client, name, action_type)
        goal_id = action.send_goal(roslibpy.Goal(goal), results.put, lambda _: None, results.put)
        try:
            values = results.get(timeout=ACTION_TIMEOUT_S)["values"]
        except queue.Empty:
            action.cancel_goal(goal_id)
            sys.exit(f"{name}: no result within {ACTION_TIMEOUT_S} s")
        # A goal that is refused has a sentence for a result.
        return dict(values) if isinstance(values, dict) else sys.exit(str(values))


def main(port: str = "9090") -> None:
    """Stand the box up, fetch it, carry it over and let it go."""
    client = roslibpy.Ros(host="127.0.0.1", port=int(port))
    client.run(timeout=CONNECT_TIMEOUT_S)
    arm = Arm(client)
    try:
        box: dict[str, Any] = {"id": "box", "header": {"frame_id": "base_link"}, "operation": 0}
        box["primitives"] = [{"type": 1, "dimensions": SIZE_M}]
        box["primitive_poses"] = [{"position": {"x": FROM[0], "y": FROM[1], "z": SIZE_M[2] / 2}}]
        arm.change_scene({"world": {"collision_objects": [box]}})

        arm.move_gripper(OPEN_RAD)
        arm.move_tip(*FROM, TRAVEL_HEIGHT_M)
        # The fingers may touch the box, and nothing else of the arm may.
        may_touch = [{"enabled": [True] * 3}] * 3
        arm.change_scene({"allowed_collision_matrix": {"entry_names": ["box", *FINGERS], "entry_values": may_touch}})
        arm.move_tip(*FROM, GRASP_HEIGHT_M)
        arm.move_gripper(CLOSED_RAD)
        held = {"link_name": "gripper_frame_link", "object": {"id": "box", "operation": 0}, "touch_links": FINGERS}
        arm.change_scene({"robot_state": {"is_diff": True, "attached_collision_objects": [held]}})
        print("the box is held")

        for x, y, z in ((*FROM, TRAVEL_HEIGHT_M), (*TO, TRAVEL_HEIGHT_M), (*TO, GRASP_HEIGHT_M)):
            arm.move_tip(x, y, z)
        arm.move_gripper(OPEN_RAD)
        let_go = {"link_name": "gripper_frame_link", "object": {"id": "box", "operation": 1}}
        arm.change_scene({"robot_state": {"is_diff": True, "attached_collision_objects": [let_go]}})
        arm.move_tip(*TO, TRAVEL_HEIGHT_M)
        print("the box stands in its new place")
    finally:
        client.terminate()


if __name__ == "__main__":
    main(*sys.argv[1:])
