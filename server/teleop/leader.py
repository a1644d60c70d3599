"""Samples of a leader, freed of a network's jitter and checked for gaps and jumps, and the map of its joints."""

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from server.errors import ServiceError
from server.execution.motions import Positions

# Half a second at 100 Hz; at a higher rate the oldest are dropped.
MAX_SAMPLES = 50

# A following that is later than this is felt by the hand that leads.
MAX_DELAY_S = 0.1

# Time over which velocities are taken: one tick of an encoder between two readings at 100 Hz is 0.15 rad/s [s].
VELOCITY_TIME_S = 0.05

# A sample that is older than this was not overtaken by the one before: the leader's clock was set back [s].
SET_BACK_S = 1.0

# Lateness is forgotten after this time, so that one late sample does not delay the following for ever.
REMEMBERED_S = 2.0

# A smaller step is taken for noise of an encoder or for a sample that was lost, however fast it would be.
JUMP_RAD = 0.25

# A hand may lead faster than the follower can go, which then comes behind; faster than this it is no hand.
JUMP_SPEEDS = 2.0


@dataclass(frozen=True)
class LeaderSample:
    """Reading of a leader."""

    stamp_s: float
    positions_rad: Positions


@dataclass(frozen=True)
class LeaderPose:
    """Pose of a leader, with the time since its reading, without the least time that a sample has taken to come [s]."""

    positions_rad: Positions
    velocity_rad_s: Positions
    latency_s: float


class JitterBuffer:
    """Samples of the last moments, with the delay that their jitter asks for; without any, the latest is followed.

    The clock of a leader elsewhere has any offset to this one; the offset is taken from the samples that came fastest.
    """

    def __init__(self, max_velocity_rad_s: Mapping[str, float], max_delay_s: float = MAX_DELAY_S) -> None:
        self._max_delay_s = max_delay_s
        self._max_velocity_rad_s = max_velocity_rad_s
        self._samples: deque[LeaderSample] = deque(maxlen=MAX_SAMPLES)
        # Arrival and transit of each sample: time of its arrival less its stamp [s].
        self._transits: deque[tuple[float, float]] = deque(maxlen=MAX_SAMPLES * 4)
        self._arrived_s = -math.inf
        self._jump = ""

    def add(self, sample: LeaderSample, now_s: float) -> None:
        """Take a sample; an older one than the last is dropped, unless the leader's clock was set back."""
        last = self._samples[-1] if self._samples else None
        if last is not None:
            if last.stamp_s - SET_BACK_S < sample.stamp_s <= last.stamp_s:
                return
            self._jump = self._jump or self._jump_between(last, sample)
            if sample.stamp_s <= last.stamp_s:
                self._samples.clear()
                self._transits.clear()
        self._samples.append(sample)
        self._transits.append((now_s, now_s - sample.stamp_s))
        while self._transits[0][0] < now_s - REMEMBERED_S:
            self._transits.popleft()
        self._arrived_s = now_s

    def age_s(self, now_s: float) -> float:
        """Return the time since the last sample came [s]; infinite before the first."""
        return now_s - self._arrived_s

    @property
    def at_once(self) -> bool:
        """True if the follower takes each sample as soon as it comes."""
        return self._max_delay_s == 0.0

    @property
    def delay_s(self) -> float:
        """Delay that evens the jitter out [s]."""
        if not self._transits:
            return 0.0
        transits = [transit for _, transit in self._transits]
        return min(max(transits) - min(transits), self._max_delay_s)

    def take_jump(self) -> str:
        """Return in words how the leader has jumped since the last call; empty if it has not."""
        jump, self._jump = self._jump, ""
        return jump

    def clear(self) -> None:
        """Forget all samples: the next one does not continue them."""
        self._samples.clear()
        self._transits.clear()
        self._arrived_s, self._jump = -math.inf, ""

    def pose(self, now_s: float) -> LeaderPose | None:
        """Return the pose to follow now, between two samples where there are two; None without a sample.

        Beyond the last sample the leader is taken to rest: it is not extrapolated.
        """
        if not self._samples:
            return None
        fastest_s = min(transit for _, transit in self._transits)
        shown_s = now_s - fastest_s - self.delay_s
        later = self._samples[-1]
        if shown_s >= later.stamp_s:
            return LeaderPose(
                later.positions_rad, self._latest_velocity(shown_s), max(now_s - fastest_s - later.stamp_s, 0.0)
            )
        for earlier in list(self._samples)[-2::-1]:
            if earlier.stamp_s <= shown_s:
                passed_s, slope = shown_s - earlier.stamp_s, _velocity(earlier, later)
                positions = {name: earlier.positions_rad[name] + passed_s * slope[name] for name in slope}
                return LeaderPose(positions, self._velocity_until(later), self.delay_s)
            later = earlier
        return LeaderPose(later.positions_rad, dict.fromkeys(later.positions_rad, 0.0), self.delay_s)

    def _latest_velocity(self, shown_s: float) -> dict[str, float]:
        """Return the velocity at the last sample, zero once the next one is overdue."""
        last = self._samples[-1]
        if len(self._samples) > 1 and shown_s - last.stamp_s > 2.0 * (last.stamp_s - self._samples[-2].stamp_s):
            return dict.fromkeys(last.positions_rad, 0.0)
        return self._velocity_until(last)

    def _velocity_until(self, last: LeaderSample) -> dict[str, float]:
        """Return the velocity in the time before a sample; zero for the first."""
        before = next(
            (each for each in reversed(self._samples) if last.stamp_s - each.stamp_s >= VELOCITY_TIME_S), None
        )
        before = before or self._samples[0]
        return dict.fromkeys(last.positions_rad, 0.0) if before is last else _velocity(before, last)

    def _jump_between(self, before: LeaderSample, after: LeaderSample) -> str:
        span_s = after.stamp_s - before.stamp_s
        for name, limit_rad_s in self._max_velocity_rad_s.items():
            if name not in before.positions_rad or name not in after.positions_rad:
                continue
            step_rad = abs(after.positions_rad[name] - before.positions_rad[name])
            if step_rad > max(JUMP_RAD, JUMP_SPEEDS * limit_rad_s * span_s):
                return f"{name} of the leader jumped by {step_rad:.2f} rad within {span_s:.3f} s"
        return ""


def _velocity(before: LeaderSample, after: LeaderSample) -> dict[str, float]:
    span_s = after.stamp_s - before.stamp_s
    return {
        name: (position - before.positions_rad[name]) / span_s
        for name, position in after.positions_rad.items()
        if name in before.positions_rad
    }


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
class FollowingJoints:
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
) -> FollowingJoints:
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
    return FollowingJoints(tuple(links))


def _known(field: str, name: str, joints: Mapping[str, object]) -> str:
    if name not in joints:
        raise ServiceError(f"{field}: must be of {', '.join(joints)}, not {name[:80]!r}")
    return name
