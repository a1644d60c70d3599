"""What each service, topic and action asks of a client: a role, and perhaps control of the arm.

What the server itself offers is listed here by name; whatever else there is belongs to clients, and needs OPERATE.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from server.access.roles import Role

# How actions end that are sent and cancelled by services and topics.
CANCEL_SERVICE = "/_action/cancel_goal"
ACTIONLIB_GOAL, ACTIONLIB_CANCEL = "/goal", "/cancel"

# The names of controllers begin with their joint group's.
FOLLOW_ACTION, FOLLOW_TOPIC = "_controller/follow_joint_trajectory", "_controller/joint_trajectory"


@dataclass(frozen=True)
class Rule:
    """What is asked of a client.

    Attributes:
        role: least role.
        stops: it stops the arm, and is open to everyone who may look at it: past globs and control.
        drives: it moves the arm or switches it, which one client does at a time.
        goal: it counts against the rate of goals.
        may_plan_only: whether it drives is said in its ``planning_options``.
    """

    role: Role
    stops: bool = False
    drives: bool = False
    goal: bool = False
    may_plan_only: bool = False


LOOKING = Rule(Role.VIEW)
STOPPING = Rule(Role.VIEW, stops=True)
WORKING = Rule(Role.OPERATE)
SWITCHING = Rule(Role.OPERATE, drives=True)
GOAL = Rule(Role.OPERATE, drives=True, goal=True)
PLANNING_GOAL = Rule(Role.OPERATE, drives=True, goal=True, may_plan_only=True)
CONFIGURING = Rule(Role.ADMIN)

_ROSAPI_LOOKING = (
    "action_servers",
    "get_param",
    "get_param_names",
    "get_ros_version",
    "get_time",
    "has_param",
    "message_details",
    "node_details",
    "nodes",
    "publishers",
    "search_param",
    "service_host",
    "service_node",
    "service_providers",
    "service_request_details",
    "service_response_details",
    "service_type",
    "services",
    "services_for_type",
    "subscribers",
    "topic_type",
    "topics",
    "topics_and_raw_types",
    "topics_for_type",
)

SERVICES: Mapping[str, Rule] = {
    **{f"/rosapi/{name}": LOOKING for name in _ROSAPI_LOOKING},
    "/rosapi/delete_param": CONFIGURING,
    "/rosapi/set_param": CONFIGURING,
    "/apply_planning_scene": WORKING,
    "/arm/emergency_stop": STOPPING,
    "/arm/enable": SWITCHING,
    # It slows the arm down to rest, which harms nobody.
    "/arm/pause": WORKING,
    "/arm/relax": SWITCHING,
    "/arm/release_control": WORKING,
    "/arm/reset_fault": SWITCHING,
    "/arm/resume": SWITCHING,
    "/arm/step_back": SWITCHING,
    "/arm/stop": STOPPING,
    "/arm/take_control": WORKING,
    "/arm/who_am_i": LOOKING,
    "/armbridge/get_logger_levels": LOOKING,
    "/armbridge/set_logger_levels": CONFIGURING,
    "/check_goals": LOOKING,
    "/check_state_validity": LOOKING,
    "/clear_octomap": WORKING,
    "/compute_cartesian_path": LOOKING,
    "/compute_fk": LOOKING,
    "/compute_ik": LOOKING,
    "/delete_robot_state": CONFIGURING,
    "/file_server/get_file": LOOKING,
    "/get_planner_params": LOOKING,
    "/get_planning_scene": LOOKING,
    "/get_robot_state": LOOKING,
    "/get_urdf": LOOKING,
    "/has_robot_state": LOOKING,
    "/list_robot_states": LOOKING,
    "/load_geometry_from_file": WORKING,
    "/moveit_goal_confirm_mode": CONFIGURING,
    "/plan_kinematic_path": LOOKING,
    "/plan_sequence_path": LOOKING,
    "/query_planner_interface": LOOKING,
    "/rename_robot_state": CONFIGURING,
    "/save_geometry_to_file": CONFIGURING,
    "/save_robot_state": CONFIGURING,
    "/servo_node/pause_servo": SWITCHING,
    "/servo_node/reset_servo_status": SWITCHING,
    "/servo_node/start_servo": SWITCHING,
    "/servo_node/stop_servo": STOPPING,
    "/servo_node/switch_command_type": SWITCHING,
    "/servo_node/unpause_servo": SWITCHING,
    "/set_planner_params": CONFIGURING,
}

# By whoever publishes there; to subscribe is to look.
TOPICS: Mapping[str, Rule] = {
    "/arm/speed_factor": SWITCHING,
    "/attached_collision_object": WORKING,
    "/collision_object": WORKING,
    "/emergency_stop": STOPPING,
    "/moveit_goal_cancel": STOPPING,
    # Who looks on may be another than who drives.
    "/moveit_goal_confirm": WORKING,
    "/moveit_goal_joints": GOAL,
    "/moveit_goal_named": GOAL,
    "/moveit_goal_pose": GOAL,
    "/planning_scene": WORKING,
    "/planning_scene_world": WORKING,
    "/servo_node/delta_joint_cmds": SWITCHING,
    "/servo_node/delta_twist_cmds": SWITCHING,
    "/servo_node/pose_target_cmds": SWITCHING,
    "/stop": STOPPING,
    "/trajectory_execution_event": STOPPING,
}

ACTIONS: Mapping[str, Rule] = {
    "/execute_trajectory": GOAL,
    "/gripper_controller/gripper_cmd": GOAL,
    "/joint_trajectory_action": GOAL,
    "/move_action": PLANNING_GOAL,
    "/move_group": PLANNING_GOAL,
    "/parallel_gripper_controller/gripper_cmd": GOAL,
    "/sequence_move_group": PLANNING_GOAL,
}


def of_service(name: str) -> Rule:
    """What a call of a service asks for, given by its fully qualified name."""
    if name.endswith(CANCEL_SERVICE):
        return STOPPING
    return SERVICES.get(name, WORKING)


def of_action(name: str) -> Rule:
    """What a goal on an action asks for, given by its fully qualified name."""
    return GOAL if name.endswith(FOLLOW_ACTION) else ACTIONS.get(name, WORKING)


def of_topic(name: str) -> Rule:
    """What a message on a topic asks for, given by its fully qualified name."""
    rule = TOPICS.get(name)
    if rule is not None:
        return rule
    if name.endswith(FOLLOW_TOPIC):
        return GOAL
    if name.endswith(ACTIONLIB_GOAL):
        return of_action(name.removesuffix(ACTIONLIB_GOAL))
    if name.endswith(ACTIONLIB_CANCEL) and of_action(name.removesuffix(ACTIONLIB_CANCEL)).drives:
        return STOPPING
    return WORKING


def plans_only(goal: object) -> bool:
    """Whether a goal, as its client spelled it, asks for a plan and for no motion."""
    options: Any = goal.get("planning_options") if isinstance(goal, Mapping) else None
    return isinstance(options, Mapping) and options.get("plan_only") is True
