"""moveit_msgs/RobotState: which positions of the joints it means, given where the arm is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from planners.problem import MoveItErrorCode
from robot.description.model import RobotModel
from server.moveit.requests.context import Message
from server.moveit.requests.refusals import refusals_as_data, refused

# MoveIt's start_state_max_bounds_error: a measured joint lies beyond its soft limit by droop, and an arm that was moved
# by hand by a little more.
MAX_START_BOUNDS_ERROR_RAD = 0.05


@dataclass(frozen=True)
class Start:
    """Where a motion begins.

    Attributes:
        positions_rad: position of every movable joint, within the limits [rad].
        warnings: what was changed or left out of account, a sentence each.
    """

    positions_rad: Mapping[str, float]
    warnings: tuple[str, ...] = ()


@refusals_as_data
def start_positions(message: Message, current_rad: Mapping[str, float] | None, robot: RobotModel) -> Start:
    """Read a state that a motion is to start from.

    Joints that it does not name are where they are. A state without joints is the present one, whatever its
    ``is_diff``; with joints and without ``is_diff`` it also says all that is attached. Positions beyond a limit by no
    more than ``MAX_START_BOUNDS_ERROR_RAD`` are moved to it.

    Args:
        message: a moveit_msgs/RobotState.
        current_rad: where the joints are now, None while that is not known [rad].
        robot: the arm.
    """
    positions = _stated(message, current_rad, robot)
    warnings = []
    for joint in robot.movable_joints:
        value = positions[joint.name]
        inside = min(max(value, joint.lower), joint.upper)
        if abs(value - inside) > MAX_START_BOUNDS_ERROR_RAD:
            raise refused(
                MoveItErrorCode.START_STATE_INVALID,
                f"the start has joint {joint.name!r} at {value:.4g} rad, beyond its limits {joint.lower:.4g} to"
                f" {joint.upper:.4g} rad by more than {MAX_START_BOUNDS_ERROR_RAD:g} rad",
                joint=joint.name,
                position_rad=value,
                lower_rad=joint.lower,
                upper_rad=joint.upper,
            )
        if inside != value:
            warnings.append(
                f"the start of joint {joint.name} is moved from {value:.4g} rad to its limit {inside:.4g} rad"
            )
            positions[joint.name] = inside
    if message["multi_dof_joint_state"]["joint_names"]:
        warnings.append("multi_dof_joint_state is ignored: the robot has no such joint")
    return Start(positions, tuple(warnings))


@refusals_as_data
def stated_positions(
    message: Message, current_rad: Mapping[str, float] | None, robot: RobotModel
) -> Mapping[str, float]:
    """Read a state that is asked about, which may lie beyond the limits; arguments as for :func:`start_positions`."""
    return _stated(message, current_rad, robot)


def attached_diff(message: Message) -> Message | None:
    """What a state says of attached things, as a moveit_msgs/PlanningScene whose other fields are left out.

    A state that names joints and is no diff says all that is attached; any other only what it names.

    Args:
        message: a moveit_msgs/RobotState.

    Returns:
        None when it says nothing.
    """
    attached, says_all = message["attached_collision_objects"], bool(message["joint_state"]["name"])
    says_all = says_all and not message["is_diff"]
    if not (attached or says_all):
        return None
    return {"is_diff": True, "robot_state": {"attached_collision_objects": attached, "is_diff": not says_all}}


def _stated(message: Message, current_rad: Mapping[str, float] | None, robot: RobotModel) -> dict[str, float]:
    """Position of every movable joint [rad]."""
    names, values = message["joint_state"]["name"], message["joint_state"]["position"]
    if len(names) != len(values):
        raise _invalid_state(f"joint_state.name has {len(names)} entries and joint_state.position {len(values)}")
    named = dict(zip(names, values, strict=True))
    for name, value in named.items():
        if name not in robot.joints:
            known = ", ".join(joint.name for joint in robot.movable_joints)
            raise _invalid_state(
                f"joint_state names the joint {name!r}, which does not exist; there are: {known}", name
            )
        if not math.isfinite(value):
            raise _invalid_state(f"joint_state has joint {name!r} at {value}, not a finite number", name)
    if len(named) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise _invalid_state(f"joint_state names the joint {twice!r} more than once", twice)
    positions: dict[str, float] = {}
    for joint in robot.movable_joints:
        value = named[joint.name] if joint.name in named else (current_rad or {}).get(joint.name)
        if value is None:
            raise refused(
                MoveItErrorCode.ROBOT_STATE_STALE,
                f"the state leaves out joint {joint.name!r}, and where it is now is not known: the arm is not read",
                joint=joint.name,
            )
        positions[joint.name] = float(value)
    return positions


def _invalid_state(message: str, joint: str = "") -> Exception:
    return refused(MoveItErrorCode.INVALID_ROBOT_STATE, message, **({"joint": joint} if joint else {}))
