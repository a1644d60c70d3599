"""Map of a leader's joints to its follower's joints: by name, scaled and mirrored."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from server.errors import ServiceError
from server.execution.motions import Positions

# Beyond, a small movement of the hand is a large one of the arm.
MAX_SCALE = 2.0

# An axis nearer to the mirror's normal than to its plane keeps its sense.
ALONG_NORMAL = math.sqrt(0.5)


# Leaders turn some degrees further than their followers, which wait at their limits then; calibrations differ by up to
# 20 degrees.
BEYOND_RAD = 0.35


@dataclass(frozen=True)
class JointLink:
    """Joint of the follower and the joint that it follows."""

    leader: str
    follower: str
    scale: float
    lower_rad: float
    upper_rad: float


@dataclass(frozen=True)
class JointMap:
    """Joints that follow."""

    links: tuple[JointLink, ...]

    def beyond_range(self, leader_rad: Positions) -> str:
        """Describe a target far beyond the follower's range, as degrees in place of radians are; empty for none."""
        for link in self.links:
            target_rad = link.scale * leader_rad.get(link.leader, link.lower_rad / link.scale)
            if not link.lower_rad - BEYOND_RAD <= target_rad <= link.upper_rad + BEYOND_RAD:
                return (
                    f"the leader's {link.leader} leads {link.follower} to {target_rad:.2f} rad, beyond its range of "
                    f"{link.lower_rad:.2f} to {link.upper_rad:.2f} rad: positions are in radians, not in degrees"
                )
        return ""

    def targets_rad(self, leader_rad: Positions) -> dict[str, float]:
        """Return the position of each following joint within its limits [rad]; an unknown position is left out."""
        return {
            link.follower: min(max(link.scale * leader_rad[link.leader], link.lower_rad), link.upper_rad)
            for link in self.links
            if link.leader in leader_rad
        }


def mirrored_joints(robot: RobotModel) -> frozenset[str]:
    """Return the joints that turn the other way in the mirror of the x-z plane of the root link.

    A mirror with normal n makes a turn about the axis a one about 2 (n a) n - a: the turn about n is the same, those
    about axes in the mirror's plane are reversed. Axes are taken where all joints are at 0. A gripper opens as before.
    """
    forward = ForwardPlacements(robot)
    placed = forward.transforms(dict.fromkeys((joint.name for joint in robot.movable_joints), 0.0))
    fingers = () if robot.gripper is None else robot.gripper.joints
    return frozenset(
        joint.name
        for joint in robot.movable_joints
        if joint.name not in fingers
        and abs((placed[joint.child][:3, :3] @ forward.axis(joint.child))[1]) < ALONG_NORMAL
    )


def joint_map(
    robot: RobotModel,
    prefix: str,
    leader_joints: Collection[str],
    leader_prefix: str = "",
    *,
    scale: float = 1.0,
    mirror: bool = False,
    pairs: tuple[Sequence[str], Sequence[str]] = ((), ()),
) -> JointMap:
    """Map a leader's joints to a follower's joints.

    Args:
        prefix: with which names of its joints begin; they may be given without.
        scale: of positions; the gripper's is 1.
        mirror: True to follow in the mirror of the x-z plane of the root link.
        pairs: joints of the leader, and for each the joint that follows it; without any, joints of equal names.
    """
    if not (math.isfinite(scale) and 0.0 < scale <= MAX_SCALE):
        raise ServiceError(f"scale: must be above 0 and at most {MAX_SCALE:g}, not {scale:g}")
    own = {joint.name.removeprefix(prefix): joint for joint in robot.movable_joints}
    led = {name.removeprefix(leader_prefix): name for name in leader_joints}
    given_leaders, given_followers = pairs
    if len(given_leaders) != len(given_followers):
        raise ServiceError(
            f"follower_joints: must have as many names as leader_joints, {len(given_leaders)}, "
            f"not {len(given_followers)}"
        )
    if given_leaders:
        leaders = [_known("leader_joints", name.removeprefix(leader_prefix), led) for name in given_leaders]
        followers = [_known("follower_joints", name.removeprefix(prefix), own) for name in given_followers]
        if len(set(followers)) < len(followers):
            raise ServiceError(f"follower_joints: must have each joint once, not {', '.join(followers)}")
    else:
        leaders = followers = [name for name in own if name in led]
        if not leaders:
            raise ServiceError(
                f"leader: has no joint of the follower's {', '.join(own)}, but {', '.join(led)}: "
                "name pairs by leader_joints and follower_joints"
            )
    turned = mirrored_joints(robot) if mirror else frozenset()
    fingers = () if robot.gripper is None else robot.gripper.joints
    links = []
    for leader, follower in zip(leaders, followers, strict=True):
        joint = own[follower]
        share = (1.0 if joint.name in fingers else scale) * (-1.0 if joint.name in turned else 1.0)
        links.append(JointLink(led[leader], joint.name, share, joint.lower, joint.upper))
    return JointMap(tuple(links))


def _known(field: str, name: str, joints: Mapping[str, object]) -> str:
    if name not in joints:
        raise ServiceError(f"{field}: must be of {', '.join(joints)}, not {name[:80]!r}")
    return name
