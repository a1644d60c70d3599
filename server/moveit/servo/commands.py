"""Messages of who steers, read: what they want of the arm, or why they want nothing that can be."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Point, Pose
from planners.servo.question import JointVelocities, ServoCommand, TipTarget, TipTwist
from robot.trajectory import Vector
from server.moveit.poses import composed, matrix_of, read_pose
from server.moveit.servo.parameters import ServoParameters

Message: TypeAlias = Mapping[str, Any]
Positions: TypeAlias = Mapping[str, float]

# Name of a frame and positions of the joints [rad] -> its pose in the root link.
Resolve: TypeAlias = Callable[[str, Positions], Pose | PlanningFailure]

UNITLESS = "unitless"

# Sticks that are a little out of tune.
UNITLESS_TOLERANCE = 1e-3


@dataclass(frozen=True)
class FramedTwist:
    """A twist along the axes of a frame, which may move with the arm; [m/s], [rad/s]."""

    linear_m_s: Point
    angular_rad_s: Point
    frame_id: str


Wanted: TypeAlias = FramedTwist | JointVelocities | TipTarget


def read_twist(message: Message, parameters: ServoParameters) -> FramedTwist | PlanningFailure:
    """Read a geometry_msgs/TwistStamped."""
    twist = message["twist"]
    parts = []
    for part, scale in (("linear", parameters.linear_scale), ("angular", parameters.rotational_scale)):
        values = {f"twist.{part}.{axis}": float(twist[part][axis]) for axis in "xyz"}
        scaled = _scaled(values, scale, parameters)
        if isinstance(scaled, PlanningFailure):
            return scaled
        parts.append((scaled[0], scaled[1], scaled[2]))
    return FramedTwist(parts[0], parts[1], message["header"]["frame_id"])


def read_joint_jog(
    message: Message, joints: Sequence[str], parameters: ServoParameters
) -> JointVelocities | PlanningFailure:
    """Read a control_msgs/JointJog.

    Args:
        message: the message; its displacements are not followed.
        joints: those that can be steered.
        parameters: scale of the velocities.
    """
    names, velocities = message["joint_names"], message["velocities"]
    if len(names) != len(velocities) or not names:
        also = "; displacements are not followed" if message["displacements"] else ""
        return _refused(f"velocities has {len(velocities)} values for {len(names)} joint_names{also}", "velocities")
    for name in names:
        if name not in joints:
            return _refused(f"joint_names has {name!r}; joints that can be steered: {', '.join(joints)}", "joint_names")
    if len(set(names)) < len(names):
        return _refused(f"joint_names has a joint twice: {', '.join(names)}", "joint_names")
    values = {f"velocities of {name}": float(value) for name, value in zip(names, velocities, strict=True)}
    scaled = _scaled(values, parameters.joint_scale, parameters)
    if isinstance(scaled, PlanningFailure):
        return scaled
    return JointVelocities(dict(zip(names, scaled, strict=True)))


def read_pose_target(message: Message, resolve: Resolve, positions_rad: Positions) -> TipTarget | PlanningFailure:
    """Read a geometry_msgs/PoseStamped; a frame that moves with the arm counts as it is now.

    Args:
        message: the message.
        resolve: finds its frame.
        positions_rad: where every movable joint is told to be now [rad].
    """
    pose = read_pose(message["pose"], "pose")
    if isinstance(pose, PlanningFailure):
        return pose
    frame = resolve(message["header"]["frame_id"], positions_rad)
    return frame if isinstance(frame, PlanningFailure) else TipTarget(composed(frame, pose))


def in_root_link(wanted: Wanted, resolve: Resolve, positions_rad: Positions) -> ServoCommand | PlanningFailure:
    """What is wanted as the planners take it; a twist turns with its frame.

    Args:
        wanted: what is wanted.
        resolve: finds its frame.
        positions_rad: where every movable joint is told to be now [rad].
    """
    if not isinstance(wanted, FramedTwist):
        return wanted
    frame = resolve(wanted.frame_id, positions_rad)
    if isinstance(frame, PlanningFailure):
        return frame
    turn = matrix_of(frame)[:3, :3]
    return TipTwist(_turned(turn, wanted.linear_m_s), _turned(turn, wanted.angular_rad_s))


def rest_of(command: ServoCommand) -> ServoCommand:
    """What is wanted once a command holds no more: what a twist does not move stays where it is."""
    return TipTwist() if isinstance(command, TipTwist) else JointVelocities({})


def _turned(turn: Vector, vector: Point) -> Point:
    x, y, z = (turn @ np.array(vector)).tolist()
    return x, y, z


def _scaled(values: Mapping[str, float], scale: float, parameters: ServoParameters) -> list[float] | PlanningFailure:
    """Values as speeds; ``values`` are named for refusals."""
    unitless = parameters.command_in_type == UNITLESS
    for name, value in values.items():
        if not math.isfinite(value):
            return _refused(f"{name} must be a finite number, not {value}", name)
        if unitless and abs(value) > 1.0 + UNITLESS_TOLERANCE:
            return _refused(f"{name} must be -1 to 1, a share of {scale:g} a second, not {value:g}", name)
    return [value * scale if unitless else value for value in values.values()]


def _refused(message: str, field: str) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, message, {"field": field})
