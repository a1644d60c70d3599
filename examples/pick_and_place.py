"""Pick up a small box and put it down elsewhere; the server: ``armbridge serve``."""

import argparse
import queue
import sys
from typing import Any

import roslibpy  # pip install roslibpy

CONNECT_TIMEOUT_S, ANSWER_TIMEOUT_S, MOTION_TIMEOUT_S = 4, 10, 60
SIZE_M = [0.025, 0.025, 0.05]
FROM, TO = (0.28, 0.1), (0.28, -0.1)  # x and y of the box before and after [m]
GRASP_HEIGHT_M, TRAVEL_HEIGHT_M = 0.04, 0.15
OPEN_RAD, CLOSED_RAD = 1.2, 0.2
HEADER = {"frame_id": "base_link"}
TIP, FINGERS = "gripper_frame_link", ["gripper_link", "moving_jaw_so101_v1_link"]
SUCCESS, ADD, REMOVE, BOX, SPHERE = 1, 0, 1, 1, 2  # of MoveItErrorCodes, CollisionObject and SolidPrimitive


class Arm:
    """An arm with a gripper; a step that fails ends the program with the server's sentence."""

    def __init__(self, client: roslibpy.Ros) -> None:
        self._client = client

    def change_scene(self, change: dict[str, Any]) -> None:
        """Apply a change (moveit_msgs/PlanningScene) to the planning scene."""
        service = roslibpy.Service(self._client, "/apply_planning_scene", "moveit_msgs/srv/ApplyPlanningScene")
        scene = {"is_diff": True, "robot_state": {"is_diff": True}, **change}
        try:
            response = service.call(roslibpy.ServiceRequest({"scene": scene}), timeout=ANSWER_TIMEOUT_S)
        except (roslibpy.core.RosTimeoutError, roslibpy.core.ServiceException) as error:
            sys.exit(f"/apply_planning_scene: {error}")
        if not response["success"]:
            sys.exit(f"the scene was not changed; the server's log says why: {change}")

    def move_tip(self, x: float, y: float, z: float) -> None:
        """Move the tip to a point of ``base_link`` [m]."""
        pose = {"position": {"x": x, "y": y, "z": z}, "orientation": {"w": 1.0}}
        region = {"primitives": [{"type": SPHERE, "dimensions": [0.005]}], "primitive_poses": [pose]}
        place = [{"link_name": TIP, "constraint_region": region, "header": HEADER}]
        goal = {"request": {"max_velocity_scaling_factor": 0.3, "goal_constraints": [{"position_constraints": place}]}}
        code = self._send_goal("/move_action", "moveit_msgs/action/MoveGroup", goal)["error_code"]
        if code["val"] != SUCCESS:
            sys.exit(f"to ({x}, {y}, {z}): {code['val']} {code['message']}")

    def move_gripper(self, angle: float) -> None:
        """Open or close the gripper to an angle [rad]; it grips an object that stops it earlier."""
        goal = {"command": {"position": angle, "max_effort": 0.3}}
        self._send_goal("/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand", goal)

    def _send_goal(self, name: str, action_type: str, goal: dict[str, Any]) -> dict[str, Any]:
        results: queue.Queue[Any] = queue.Queue()
        action = roslibpy.ActionClient(self._client, name, action_type)
        goal_id = action.send_goal(roslibpy.Goal(goal), results.put, lambda _: None, results.put)
        try:
            values = results.get(timeout=MOTION_TIMEOUT_S)["values"]  # of a rejected goal: a sentence
        except queue.Empty:
            action.cancel_goal(goal_id)
            sys.exit(f"{name}: no result within {MOTION_TIMEOUT_S} s")
        return dict(values) if isinstance(values, dict) else sys.exit(f"{name}: {values}")


def main() -> None:
    """Add the box to the scene, grip it, carry it over and put it down."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="name or address of the server (default: %(default)s)")
    parser.add_argument("--port", default=9090, type=int, help="port of the server (default: %(default)s)")
    arguments = parser.parse_args()
    client = roslibpy.Ros(host=arguments.host, port=arguments.port)
    try:
        client.run(timeout=CONNECT_TIMEOUT_S)
    except roslibpy.core.RosTimeoutError:
        sys.exit(f'no server answers at ws://{arguments.host}:{arguments.port}: start one with "make run"')
    arm = Arm(client)
    box = {"primitives": [{"type": BOX, "dimensions": SIZE_M}]}
    box["primitive_poses"] = [{"position": {"x": FROM[0], "y": FROM[1], "z": SIZE_M[2] / 2}}]
    arm.change_scene({"world": {"collision_objects": [{"id": "box", "header": HEADER, "operation": ADD, **box}]}})
    arm.move_gripper(OPEN_RAD)
    arm.move_tip(*FROM, TRAVEL_HEIGHT_M)
    # Only the fingers may touch the box.
    may_touch = [{"enabled": [True] * 3}] * 3
    arm.change_scene({"allowed_collision_matrix": {"entry_names": ["box", *FINGERS], "entry_values": may_touch}})
    arm.move_tip(*FROM, GRASP_HEIGHT_M)
    arm.move_gripper(CLOSED_RAD)
    held = {"link_name": TIP, "object": {"id": "box", "operation": ADD}, "touch_links": FINGERS}
    arm.change_scene({"robot_state": {"is_diff": True, "attached_collision_objects": [held]}})
    print("the box is held")
    for x, y, z in ((*FROM, TRAVEL_HEIGHT_M), (*TO, TRAVEL_HEIGHT_M), (*TO, GRASP_HEIGHT_M)):
        arm.move_tip(x, y, z)
    arm.move_gripper(OPEN_RAD)
    released = {"link_name": TIP, "object": {"id": "box", "operation": REMOVE}, "touch_links": FINGERS}
    arm.change_scene({"robot_state": {"is_diff": True, "attached_collision_objects": [released]}})
    arm.move_tip(*TO, TRAVEL_HEIGHT_M)
    print("the box stands in its new place")
    client.terminate()


if __name__ == "__main__":
    main()
