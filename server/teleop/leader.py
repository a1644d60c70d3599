"""Leader of a follower: its samples as they come, with their jitter, gaps and jumps, and how its joints are mapped."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from server.errors import ServiceError

# Samples of the last time that are kept, to interpolate between and to know their jitter [s]; at 100 Hz 50 of them.
KEPT_S = 0.5

# Longest delay by which jitter is evened out: a network that is worse than that makes the follower jerk [s].
MAX_DELAY_S = 0.1

# Older samples steer nothing: the follower brakes [s].
STALE_S = 0.2

# Faster than a hand turns a joint of an arm, and what a stale reading may add [rad/s], [rad].
HAND_RAD_S = 15.0
JUMP_RAD = 0.2

# Velocity is that of the last time, which evens out the servos' ticks [s].
VELOCITY_OVER_S = 0.05


@dataclass(frozen=True)
class LeaderPose:
    """Leader at a moment.

    Attributes:
        position_rad: by joint of the leader [rad].
        velocity_rad_s: likewise [rad/s].
        stamp_s: time of the reading that it goes back to, on the clock of the arrivals [s].
    """

    position_rad: Mapping[str, float]
    velocity_rad_s: Mapping[str, float]
    stamp_s: float


class LeaderTrack:
    """Samples of a leader.

    The samples of a network come late and unevenly: they are played with a delay of the jitter of the last half second,
    :data:`MAX_DELAY_S` at most, and interpolated. A leader at this server has no jitter, and no delay.

    Attributes:
        jumped: sentence about a jump of the leader; empty without one.
    """

    def __init__(self) -> None:
        # Stamp on the leader's clock, time of arrival, and positions; oldest first.
        self._samples: deque[tuple[float, float, dict[str, float]]] = deque()
        self.jumped = ""

    def add(self, stamp_s: float, arrived_s: float, position_rad: Mapping[str, float]) -> None:
        """Take a sample; one that is older than the last, or not finite, is left out.

        Args:
            stamp_s: time of its reading, on the leader's clock [s].
            arrived_s: monotonic time at which it came [s].
            position_rad: by joint [rad].
        """
        if not all(math.isfinite(value) for value in position_rad.values()) or not position_rad:
            return
        if self._samples:
            last_s, last_arrived_s, last = self._samples[-1]
            if stamp_s <= last_s and arrived_s - last_arrived_s < STALE_S:
                return
            self._watch_for_jump(last, position_rad, stamp_s - last_s)
            if stamp_s <= last_s or last.keys() != position_rad.keys():
                # A leader that was started anew, whose clock or joints are others.
                self._samples.clear()
        self._samples.append((stamp_s, arrived_s, dict(position_rad)))
        while self._samples[0][1] < arrived_s - KEPT_S:
            self._samples.popleft()

    def _watch_for_jump(self, last: Mapping[str, float], now: Mapping[str, float], passed_s: float) -> None:
        allowed_rad = JUMP_RAD + HAND_RAD_S * max(passed_s, 0.0)
        for name in last.keys() & now.keys():
            if abs(now[name] - last[name]) > allowed_rad:
                self.jumped = f"the leader jumped: {name} by {now[name] - last[name]:.2f} rad in {passed_s:.3f} s"

    @property
    def delay_s(self) -> float:
        """Delay by which the jitter is evened out [s]."""
        transits_s = [arrived_s - stamp_s for stamp_s, arrived_s, _ in self._samples]
        return min(max(transits_s) - min(transits_s), MAX_DELAY_S) if transits_s else 0.0

    def pose(self, now_s: float) -> LeaderPose | None:
        """Return where the leader is; None without a sample that is fresh enough.

        Args:
            now_s: monotonic time [s].
        """
        if not self._samples or now_s - self._samples[-1][1] > STALE_S:
            return None
        names = tuple(self._samples[-1][2])
        stamps_s = np.array([stamp_s for stamp_s, _, _ in self._samples])
        values = np.array([[positions[name] for name in names] for _, _, positions in self._samples])
        # The leader's clock by that of the arrivals: the quickest sample took no time.
        behind_s = min(arrived_s - stamp_s for stamp_s, arrived_s, _ in self._samples)
        at_s = min(now_s - behind_s - self.delay_s, float(stamps_s[-1]))
        position = _at(stamps_s, values, at_s)
        before_s = max(at_s - VELOCITY_OVER_S, float(stamps_s[0]))
        passed_s = at_s - before_s
        velocity = (position - _at(stamps_s, values, before_s)) / passed_s if passed_s > 0.0 else np.zeros(len(names))
        return LeaderPose(
            dict(zip(names, position.tolist(), strict=True)),
            dict(zip(names, velocity.tolist(), strict=True)),
            at_s + behind_s,
        )


def _at(stamps_s: np.ndarray, values: np.ndarray, at_s: float) -> np.ndarray:
    """Interpolate between samples; before the first and after the last it is that sample."""
    return np.array([np.interp(at_s, stamps_s, column) for column in values.T])


@dataclass(frozen=True)
class MappedJoint:
    """Joint of the follower: ``position = factor * leader's position``."""

    leader: str
    follower: str
    factor: float = 1.0


def joint_map(
    leader_joints: Sequence[str],
    follower: RobotModel,
    names: tuple[Sequence[str], Sequence[str]],
    prefixes: tuple[str, str],
    *,
    scale: float,
    mirror: bool,
) -> tuple[MappedJoint, ...]:
    """Map joints of a leader to those of a follower.

    Args:
        leader_joints: joints of the leader.
        follower: its description; its joints may begin with the arm's name.
        names: joints of the leader, and those of the follower that follow them; both empty for all of equal names.
        prefixes: what the names of the leader's joints and of the follower's begin with, the names of their arms.
        scale: of the motion.
        mirror: true to turn about the axes in the arm's plane of symmetry the other way round.

    Raises:
        ServiceError: the lists are not as long, or name a joint that the leader or the follower does not have.
    """
    own = {joint.name: joint for joint in follower.movable_joints}
    short = {name.removeprefix(prefixes[1]): name for name in own}
    leaders, followers = list(names[0]), list(names[1])
    if len(leaders) != len(followers):
        raise ServiceError(f"leader_joints has {len(leaders)} joints, and follower_joints {len(followers)}")
    if not leaders:
        by_plain = {name.removeprefix(prefixes[0]): name for name in leader_joints}
        pairs = [(by_plain[plain], name) for plain, name in short.items() if plain in by_plain]
        if not pairs:
            raise ServiceError(
                f"leader and follower have no joint of the same name: the leader has {', '.join(leader_joints)}, "
                f"the follower {', '.join(own)}; name them in leader_joints and follower_joints"
            )
    else:
        pairs = []
        for index, (leader, wanted) in enumerate(zip(leaders, followers, strict=True)):
            if leader not in leader_joints:
                raise ServiceError(
                    f"leader_joints[{index}]: the leader has no joint {leader!r}, but {', '.join(leader_joints)}"
                )
            if wanted not in own and wanted not in short:
                raise ServiceError(
                    f"follower_joints[{index}]: the follower has no joint {wanted!r}, but {', '.join(own)}"
                )
            pairs.append((leader, wanted if wanted in own else short[wanted]))
    turned = mirrored_joints(follower) if mirror else frozenset()
    return tuple(MappedJoint(leader, name, -scale if name in turned else scale) for leader, name in pairs)


def mirrored_joints(robot: RobotModel) -> frozenset[str]:
    """Return the joints that turn the other way round in a mirror: at zero their axes lie in the plane of symmetry.

    That is the plane of the root link's x and z axes, in which an arm reaches forward.
    """
    placements = ForwardPlacements(robot)
    zero = {joint.name: 0.0 for joint in robot.movable_joints}
    transforms = placements.transforms(zero)
    gripper = frozenset() if robot.gripper is None else frozenset(robot.gripper.joints)
    return frozenset(
        joint.name
        for joint in robot.movable_joints
        if joint.name not in gripper
        and abs((transforms[joint.child][:3, :3] @ placements.axis(joint.child))[1]) < math.sqrt(0.5)
    )
