"""Direction of each joint by a motion of the hand: the request in words of the URDF, and the meaning of the ticks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.description.servo_table import ServoSpec
from robot.errors import CalibrationError
from robot.trajectory import Vector

# A hand moves a joint further than this (9 deg) without noticing; less may be a twitch, or the arm that sinks.
LEAST_MOTION_TICKS = 100

ALONG_AXIS = 0.35  # a link whose end is seen within this slope (20 deg) of its axis is turned rather than moved
AT_JOINT_M = 0.005  # an end that is nearer to the joint's origin gives no direction [m]

# Cosine of the angle (18 deg) within which an axis counts as vertical: such a joint turns the arm in any pose.
VERTICAL = 0.95

# The arm points somewhere when its tip is so far from its foot; otherwise forward is the root link's x axis [m].
REACH_M = 0.05


@dataclass(frozen=True)
class AskedMotion:
    """Motion of one joint to ask for."""

    request: str  # imperative sentence without a full stop
    rises: bool  # True if the joint's position rises meanwhile


def asked_motions(robot: RobotModel) -> dict[str, AskedMotion]:
    """Return the motion to ask for each joint that turns, by joint."""
    words = _Words(robot)
    gripper = {} if robot.gripper is None else dict.fromkeys(robot.gripper.joints, robot.gripper)
    motions = {}
    for joint in robot.movable_joints:
        if (found := gripper.get(joint.name)) is not None:
            motions[joint.name] = AskedMotion("open the gripper", rises=found.open > found.closed)
        else:
            motions[joint.name] = words.motion(joint.name)
    return motions


def turned_the_other_way(servo: ServoSpec, motion: AskedMotion, moved_ticks: int) -> bool:
    """Return True when a servo turned against its sign; raise CalibrationError when it was hardly moved."""
    if abs(moved_ticks) < LEAST_MOTION_TICKS:
        raise CalibrationError(
            "direction",
            servo.joint,
            f"was moved by {abs(moved_ticks)} ticks only, {LEAST_MOTION_TICKS} are needed: {motion.request}, further",
        )
    expected = servo.sign if motion.rises else -servo.sign
    return (moved_ticks > 0) != (expected > 0)


def spoken(name: str) -> str:
    """Return the name of a link or joint as words."""
    return name.removesuffix("_link").replace("_", " ").replace("-", " ").strip() or name


class _Words:
    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        forward = ForwardPlacements(robot)
        self._zero: Mapping[str, float] = {
            joint.name: min(max(0.0, joint.lower), joint.upper) for joint in robot.movable_joints
        }
        self._placed = forward.transforms(self._zero)
        self._axis = forward.axis
        self._tip = robot.tip_link or robot.links[-1]
        tip = self._placed[self._tip][:3, 3]
        reach = np.array([tip[0], tip[1], 0.0])
        away_m = float(np.linalg.norm(reach))
        self._forward = reach / away_m if away_m > REACH_M else np.array([1.0, 0.0, 0.0])

    def motion(self, name: str) -> AskedMotion:
        joint = self._robot.joints[name]
        place = self._placed[joint.child]
        axis, at_m = place[:3, :3] @ self._axis(joint.child), place[:3, 3]
        if joint.type == "prismatic":
            return self._shift(name, joint.child, axis)
        if abs(axis[2]) > VERTICAL:
            request = f"turn {spoken(name)} to the left, counter-clockwise as seen from above"
            return AskedMotion(request, rises=bool(axis[2] > 0.0))
        arm_m = self._end(joint.child) - at_m
        across_m = arm_m - axis * (axis @ arm_m)
        length_m = float(np.linalg.norm(arm_m))
        if np.linalg.norm(across_m) <= max(ALONG_AXIS * length_m, AT_JOINT_M):
            along = float(axis @ (arm_m if length_m > AT_JOINT_M else self._forward))
            # A right-handed turn about an axis that points away from the eye is clockwise.
            request = f"turn {spoken(name)} clockwise, as seen along the arm from its foot"
            return AskedMotion(request, rises=along >= 0.0)
        velocity: Vector = np.cross(axis, across_m).astype(np.float64)
        return self._shift(name, joint.child, velocity)

    def _shift(self, name: str, link: str, velocity: Vector) -> AskedMotion:
        left = np.cross((0.0, 0.0, 1.0), self._forward)
        parts = {"up": velocity[2], "forward": velocity @ self._forward, "to the left": velocity @ left}
        word = max(parts, key=lambda each: abs(parts[each]))
        way = {"up": "up", "forward": "forward, away from the arm's foot", "to the left": "to the left"}[word]
        request = f"move {spoken(name)} so that the far end of {spoken(link)} goes {way}"
        return AskedMotion(request, rises=bool(parts[word] > 0.0))

    def _end(self, link: str) -> Vector:
        """Return the end of a link: the next joint on the way to the tip, or the tip, shape (3,) [m]."""
        by_child = {joint.child: joint for joint in self._robot.joints.values()}
        end, at = self._tip, self._tip
        while at != link and (joint := by_child.get(at)) is not None:
            if joint.movable:
                end = at
            at = joint.parent
        ended: Vector = self._placed[end if at == link else link][:3, 3]
        return ended
