"""A goal that would work instead of one that was refused, ready to be sent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robot.description.model import RobotModel

NAMED_TOPIC, NAMED_TYPE = "/moveit_goal_named", "std_msgs/String"
JOINTS_TOPIC, JOINTS_TYPE = "/moveit_goal_joints", "sensor_msgs/JointState"
POSE_TOPIC, POSE_TYPE = "/moveit_goal_pose", "geometry_msgs/PoseStamped"


@dataclass(frozen=True)
class Suggestion:
    """A goal of the simple layer.

    Attributes:
        topic: where to publish it.
        type_name: of the topic.
        msg: the message.
        words: the goal in a sentence.
    """

    topic: str
    type_name: str
    msg: dict[str, Any]
    words: str

    def as_data(self) -> dict[str, Any]:
        """The fields of rosbridge's operations advertise and publish."""
        return {"topic": self.topic, "type": self.type_name, "msg": self.msg}


def suggestion(asked: Mapping[str, Any], details: Mapping[str, Any], robot: RobotModel) -> Suggestion | None:
    """The goal that would work, from what a refusal found; None when it found none.

    Args:
        asked: the message that was refused; empty when it could not be read.
        details: what was found, as in `planners.problem.PlanningFailure`.
        robot: the arm.
    """
    if "nearest_name" in details:
        name = details["nearest_name"]
        return Suggestion(NAMED_TOPIC, NAMED_TYPE, {"data": name}, f"the named target {name!r}")
    if "free_rad" in details:
        return _joints(details["free_rad"], "the last free configuration on the way there")
    if "free_m" in details:
        return _point(details["free_m"], robot.root_link, "the last free point on the way there")
    if "nearest_m" in details:
        return _point(details["nearest_m"], robot.root_link, "the nearest point")
    if {"joint", "lower_rad", "upper_rad"} <= details.keys() and details["joint"] in asked.get("name", ()):
        return _within_limits(asked, robot)
    return None


def _point(position_m: list[float], frame: str, what: str) -> Suggestion:
    x, y, z = position_m
    pose = {"position": {"x": x, "y": y, "z": z}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    msg = {"header": {"frame_id": frame}, "pose": pose}
    return Suggestion(POSE_TOPIC, POSE_TYPE, msg, f"{what}, ({x:.3f}, {y:.3f}, {z:.3f}) m")


def _joints(positions_rad: Mapping[str, float], what: str) -> Suggestion:
    msg = {"name": list(positions_rad), "position": list(positions_rad.values())}
    listed = ", ".join(f"{name} {position_rad:.3f}" for name, position_rad in positions_rad.items())
    return Suggestion(JOINTS_TOPIC, JOINTS_TYPE, msg, f"{what}, {listed} rad")


def _within_limits(asked: Mapping[str, Any], robot: RobotModel) -> Suggestion:
    """The joint goal with every joint within its limits."""
    known = {name: value for name, value in zip(asked["name"], asked["position"], strict=True) if name in robot.joints}
    limits = {name: (robot.joints[name].lower, robot.joints[name].upper) for name in known}
    return _joints(
        {name: min(max(known[name], low), high) for name, (low, high) in limits.items()}, "within the limits"
    )
