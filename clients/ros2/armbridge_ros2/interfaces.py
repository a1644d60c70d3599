"""Topics, services and actions that are joined, and ROS messages as the server's JSON has them."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple


class Joined(NamedTuple):
    """A topic, service or action, with its type as ROS 2 spells it.

    Attributes:
        latched: late subscribers get the last message (transient local).
    """

    name: str
    type: str
    latched: bool = False


FROM_SERVER = (
    Joined("/joint_states", "sensor_msgs/msg/JointState"),
    Joined("/robot_description", "std_msgs/msg/String", latched=True),
    Joined("/robot_description_semantic", "std_msgs/msg/String", latched=True),
    Joined("/tf", "tf2_msgs/msg/TFMessage"),
    Joined("/tf_static", "tf2_msgs/msg/TFMessage", latched=True),
    Joined("/arm/state", "diagnostic_msgs/msg/DiagnosticStatus", latched=True),
    Joined("/moveit_goal_status", "diagnostic_msgs/msg/DiagnosticStatus"),
    Joined("/moveit_goal_result", "moveit_msgs/msg/MoveItErrorCodes"),
    Joined("/monitored_planning_scene", "moveit_msgs/msg/PlanningScene"),
    Joined("/display_planned_path", "moveit_msgs/msg/DisplayTrajectory", latched=True),
)
SCENE = (
    Joined("/planning_scene", "moveit_msgs/msg/PlanningScene"),
    Joined("/collision_object", "moveit_msgs/msg/CollisionObject"),
    Joined("/attached_collision_object", "moveit_msgs/msg/AttachedCollisionObject"),
)
# Messages that wait together are taken in this order: objects before goals, stops last.
TO_SERVER = (
    *SCENE,
    Joined("/moveit_goal_named", "std_msgs/msg/String"),
    Joined("/moveit_goal_joints", "sensor_msgs/msg/JointState"),
    Joined("/moveit_goal_pose", "geometry_msgs/msg/PoseStamped"),
    Joined("/arm_controller/joint_trajectory", "trajectory_msgs/msg/JointTrajectory"),
    # By which MoveGroupInterface and pymoveit2 stop the arm.
    Joined("/trajectory_execution_event", "std_msgs/msg/String"),
    Joined("/stop", "std_msgs/msg/Empty"),
)
SERVICES = (
    *(
        Joined(f"/arm/{name}", "std_srvs/srv/Trigger")
        for name in ("stop", "emergency_stop", "enable", "relax", "park", "reset_fault")
    ),
    Joined("/compute_ik", "moveit_msgs/srv/GetPositionIK"),
    Joined("/compute_fk", "moveit_msgs/srv/GetPositionFK"),
    Joined("/compute_cartesian_path", "moveit_msgs/srv/GetCartesianPath"),
    Joined("/check_state_validity", "moveit_msgs/srv/GetStateValidity"),
    Joined("/plan_kinematic_path", "moveit_msgs/srv/GetMotionPlan"),
    Joined("/query_planner_interface", "moveit_msgs/srv/QueryPlannerInterfaces"),
    Joined("/get_planner_params", "moveit_msgs/srv/GetPlannerParams"),
    Joined("/set_planner_params", "moveit_msgs/srv/SetPlannerParams"),
    Joined("/get_planning_scene", "moveit_msgs/srv/GetPlanningScene"),
    Joined("/apply_planning_scene", "moveit_msgs/srv/ApplyPlanningScene"),
)
ACTIONS = (
    Joined("/arm_controller/follow_joint_trajectory", "control_msgs/action/FollowJointTrajectory"),
    Joined("/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand"),
    Joined("/move_action", "moveit_msgs/action/MoveGroup"),
    Joined("/execute_trajectory", "moveit_msgs/action/ExecuteTrajectory"),
)


def ros_class(type_name: str) -> Any:
    """Return the class of a type.

    Raises:
        ImportError: its package is not installed here.
    """
    package, kind, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), name)


def to_json(value: Any) -> Any:
    """Return a ROS message, or a value in one, as JSON."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: to_json(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        # rclpy has a byte as bytes of length 1, as the operation of a CollisionObject, and byte[] as a list of them.
        return value[0]
    if isinstance(value, str | bool | int | float):
        return value
    # rclpy has lists of numbers as arrays of Python, or of numpy where their length is fixed, as in a mesh's triangles.
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Sequence):
        return [to_json(each) for each in value]
    raise TypeError(f"a ROS message holds a {type(value).__name__}, which JSON cannot hold")


def fill(message: Any, values: Mapping[str, Any]) -> Any:
    """Set the fields of a ROS message from JSON, and return the message."""
    for name, type_name in message.get_fields_and_field_types().items():
        if name in values:
            setattr(message, name, _value(getattr(message, name), type_name, values[name]))
    return message


def refused(answer: Any, sentence: str) -> Any:
    """Return an action's result, or a service's response, that names a failure, where its type has fields for one."""
    if hasattr(answer, "error_string"):
        # control_msgs/FollowJointTrajectory: INVALID_GOAL
        answer.error_code, answer.error_string = -1, sentence
    elif hasattr(answer, "error_code"):
        # moveit_msgs/MoveItErrorCodes: FAILURE; its sentence is younger than ROS 2 Humble.
        fill(answer.error_code, {"val": 99999, "message": sentence})
    elif hasattr(answer, "motion_plan_response"):
        refused(answer.motion_plan_response, sentence)
    elif hasattr(answer, "message"):
        answer.message = sentence
    return answer


def _value(present: Any, type_name: str, value: Any) -> Any:
    if hasattr(present, "get_fields_and_field_types"):
        return fill(present, value)
    element = type_name.removeprefix("sequence<").split("[")[0].removesuffix(">").split(",")[0]
    if isinstance(value, list) and "/" in element:
        package, name = element.split("/")
        element_class = ros_class(f"{package}/msg/{name}")
        return [fill(element_class(), each) for each in value]
    if element == "octet":
        return [bytes([each]) for each in value] if isinstance(value, list) else bytes([value])
    # JSON writes a whole float without its point.
    return float(value) if isinstance(present, float) else value
