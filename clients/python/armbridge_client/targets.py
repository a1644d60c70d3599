"""Targets of motions: a name, joint positions, or a pose of the tip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from armbridge_client.messages import (
    Constraints,
    DiagnosticStatus,
    GoalTarget,
    Header,
    JointConstraint,
    JointState,
    OrientationConstraint,
    Point,
    Pose,
    PoseStamped,
    PositionConstraint,
    Quaternion,
    SolidPrimitive,
)
from armbridge_client.motion import seconds

# A name; joint positions by joint [rad, or m for joints that slide]; a pose; a suggestion of the server.
Target: TypeAlias = str | Mapping[str, float] | PoseStamped | GoalTarget

SPHERE = 2  # shape_msgs/SolidPrimitive
# The server's own tolerances of a pose goal (docs/goals.md).
POSITION_TOLERANCE_M, ORIENTATION_TOLERANCE_RAD = 0.01, 0.01


@dataclass(frozen=True)
class State:
    """The arm at one moment.

    Attributes:
        stamp_s: time of the measurement [s since 1970].
        position_rad: positions by joint [rad, or m for joints that slide].
        velocity_rad_s: velocities by joint.
        load: shares of the full motor duty by joint, -1 to 1.
        mode: disconnected, connected, relaxed, holding, moving or fault; empty if unknown yet.
        fault: code of the fault, empty without one.
        message: the server's sentence about the arm.
        stops: number of the server's last stop, for :func:`armbridge_client.after_stop`.
    """

    stamp_s: float
    position_rad: Mapping[str, float]
    velocity_rad_s: Mapping[str, float]
    load: Mapping[str, float]
    mode: str = ""
    fault: str = ""
    message: str = ""
    stops: int = 0


@dataclass(frozen=True)
class Control:
    """The client that controls the arm; an empty holder if the arm is free.

    Attributes:
        free_in_s: time until the arm is free without another request [s].
        message: all of it in a sentence.
    """

    holder: str
    free_in_s: float
    message: str


@dataclass(frozen=True)
class WaitingGoal:
    """A goal that waits for a person's answer.

    Attributes:
        client: name of the client that sent the goal.
        proposed: True for a goal of a client that may only propose, False for a goal of confirm mode.
        summary: the planned motion in a sentence.
    """

    goal_id: str
    client: str
    proposed: bool
    summary: str
    duration_s: float


def pose(x: float, y: float, z: float, *, frame: str = "", orientation: Sequence[float] | None = None) -> PoseStamped:
    """Return a pose of the tip.

    Args:
        x: position [m], as y and z.
        frame: link, object or subframe in whose axes the pose is; empty for the base of the arm.
        orientation: unit quaternion x, y, z, w; only arms with six joints or more use it.
    """
    # Numbers of numpy are no numbers of JSON.
    turn = Quaternion() if orientation is None else Quaternion(*map(float, orientation))
    return PoseStamped(Header(frame_id=frame), Pose(Point(float(x), float(y), float(z)), turn))


def goal_target(target: Target) -> GoalTarget:
    """Return a target as the message that goals contain."""
    if isinstance(target, GoalTarget):
        return target
    if isinstance(target, str):
        return GoalTarget(named=target)
    if isinstance(target, PoseStamped):
        return GoalTarget(pose=target)
    return GoalTarget(joints=JointState(name=list(target), position=[float(each) for each in target.values()]))


def constraints(goal: GoalTarget, named_rad: Mapping[str, float], tip_link: str) -> Constraints:
    """Return MoveIt's constraints of a target.

    Args:
        named_rad: joint positions of a named target.
        tip_link: link that a pose is for.
    """
    joints = dict(named_rad) or dict(zip(goal.joints.name, goal.joints.position))
    if joints:
        return Constraints(joint_constraints=[JointConstraint(name, position) for name, position in joints.items()])
    region = PositionConstraint(header=goal.pose.header, link_name=tip_link)
    region.constraint_region.primitives = [SolidPrimitive(SPHERE, [POSITION_TOLERANCE_M])]
    region.constraint_region.primitive_poses = [Pose(goal.pose.pose.position)]
    turn = goal.pose.pose.orientation
    if turn == Quaternion():
        return Constraints(position_constraints=[region])
    tolerance = ORIENTATION_TOLERANCE_RAD
    about = OrientationConstraint(
        goal.pose.header,
        turn,
        tip_link,
        absolute_x_axis_tolerance=tolerance,
        absolute_y_axis_tolerance=tolerance,
        absolute_z_axis_tolerance=tolerance,
    )
    return Constraints(position_constraints=[region], orientation_constraints=[about])


def state_of(joints: JointState, arm: DiagnosticStatus) -> State:
    """Return the state of a message of joint states and of the latest message about the arm."""
    values = {pair.key: pair.value for pair in arm.values}
    return State(
        seconds(joints.header.stamp),
        dict(zip(joints.name, joints.position)),
        dict(zip(joints.name, joints.velocity)),
        dict(zip(joints.name, joints.effort)),
        values.get("mode", ""),
        values.get("fault", ""),
        arm.message,
        stops_of(arm),
    )


def stops_of(arm: DiagnosticStatus) -> int:
    """Return the number of the server's last stop, of a message about the arm."""
    return next((int(pair.value) for pair in arm.values if pair.key == "stops"), 0)
