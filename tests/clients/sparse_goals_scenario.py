"""What lab scripts send to MoveIt with roslibpy, in ROS 1 words and with little more than the names; one JSON object.

Two of them: one plans its segments alone, stitches them by hand and has the whole executed; one moves to a pose, then
along a line. Goals come without tolerances, headers or options, and answers are read by ``secs`` and ``nsecs``.

Usage: python sparse_goals_scenario.py PORT
"""

import json
import sys
import threading
from typing import Any

import roslibpy

try:
    from roslibpy import actionlib
except ImportError:
    from roslibpy.ros1 import actionlib

STEP_TIMEOUT_S = 15.0
GROUP = "arm"
JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
STOPS = [[0.4, -0.5, 0.6, 0.3, 0.0], [-0.4, -0.5, 0.6, 0.3, 0.5], [0.0, 0.0, 0.0, 0.0, 0.0]]
SPEEDS = [1.0, 0.5, 0.8]
NANOSECONDS = 1_000_000_000


def constraints(positions: list[float]) -> list[dict[str, Any]]:
    """Joint constraints without tolerances."""
    joints = [{"joint_name": name, "position": at, "weight": 1.0} for name, at in zip(JOINTS, positions, strict=True)]
    return [{"joint_constraints": joints}]


class Lab:
    """The clients that such a script makes."""

    def __init__(self, ros: roslibpy.Ros) -> None:
        self._move_group = actionlib.ActionClient(ros, "/move_group", "moveit_msgs/MoveGroupAction")
        self._execute = actionlib.ActionClient(ros, "/execute_trajectory", "moveit_msgs/ExecuteTrajectoryAction")
        self._line = roslibpy.Service(ros, "/compute_cartesian_path", "moveit_msgs/GetCartesianPath")

    def stitched(self) -> dict[str, Any]:
        """Plan segment by segment, each from the end of the last, and execute all as one trajectory."""
        start: dict[str, Any] = {"is_diff": True}
        segments = []
        for stop, speed in zip(STOPS, SPEEDS, strict=True):
            planned = self._planned(start, stop, speed)
            segments.append(planned)
            last = planned["points"][-1]
            start = {"joint_state": {"name": planned["joint_names"], "position": last["positions"]}}
        whole = {**segments[0], "points": _one_after_the_other(segments)}
        result = self._result(self._execute, {"trajectory": {"joint_trajectory": whole}})
        return {"segments": len(segments), "code": result["error_code"]["val"]}

    def line(self) -> dict[str, Any]:
        """Move to a pose without any option, then along a line from there."""
        request = {"group_name": GROUP, "goal_constraints": constraints([0.0, -0.6, 0.9, 0.3, 0.0])}
        timing = {"allowed_planning_time": 10.0, "num_planning_attempts": 1}
        moved = self._result(self._move_group, {"request": {**request, **timing}})
        asked = {
            "header": {"stamp": {"secs": 0, "nsecs": 0}, "frame_id": "base_link"},
            "start_state": {"is_diff": True},
            "group_name": GROUP,
            "link_name": "gripper_frame_link",
            "waypoints": [{"position": {"x": 0.27, "y": 0.0, "z": 0.12}, "orientation": {"w": 1.0}}],
            "max_step": 0.01,
            "jump_threshold": 0.0,
        }
        answer = self._line.call(roslibpy.ServiceRequest(asked), timeout=STEP_TIMEOUT_S)
        done = self._result(self._execute, {"trajectory": answer["solution"]})
        codes = [moved["error_code"]["val"], done["error_code"]["val"]]
        return {"fraction": answer["fraction"], "codes": codes}

    def _planned(self, start: dict[str, Any], stop: list[float], speed: float) -> dict[str, Any]:
        request = {
            "group_name": GROUP,
            "start_state": start,
            "goal_constraints": constraints(stop),
            "max_velocity_scaling_factor": speed,
            "max_acceleration_scaling_factor": 0.5,
            "allowed_planning_time": 10.0,
        }
        options = {"plan_only": True, "planning_scene_diff": {"is_diff": True}}
        result = self._result(self._move_group, {"request": request, "planning_options": options})
        if result["error_code"]["val"] != 1:
            raise RuntimeError(f"not planned: {result['error_code']}")
        trajectory: dict[str, Any] = result["planned_trajectory"]["joint_trajectory"]
        return trajectory

    def _result(self, client: actionlib.ActionClient, message: dict[str, Any]) -> dict[str, Any]:
        ended, results = threading.Event(), list[dict[str, Any]]()
        goal = actionlib.Goal(client, roslibpy.Message(message))
        goal.on("result", lambda result: (results.append(result), ended.set()))
        goal.send()
        if not ended.wait(STEP_TIMEOUT_S):
            raise TimeoutError(f"{client.server_name}: no result")
        return results[0]


def _one_after_the_other(segments: list[dict[str, Any]]) -> list[dict[str, Any]]:
    points, offset_s = [], 0.0
    for segment in segments:
        for point in segment["points"]:
            at = point["time_from_start"]
            at_s = offset_s + at["secs"] + at["nsecs"] / NANOSECONDS
            time = {"secs": int(at_s), "nsecs": int((at_s - int(at_s)) * NANOSECONDS)}
            points.append({**point, "time_from_start": time})
        last = segment["points"][-1]["time_from_start"]
        offset_s += last["secs"] + last["nsecs"] / NANOSECONDS
    return points


def main(port: int) -> None:
    """Run both scripts and print what came of them."""
    ros = roslibpy.Ros("127.0.0.1", port)
    ros.run(STEP_TIMEOUT_S)
    lab = Lab(ros)
    print(json.dumps({"stitched": lab.stitched(), "line": lab.line()}))
    ros.terminate()


if __name__ == "__main__":
    main(int(sys.argv[1]))
