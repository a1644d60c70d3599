"""Targets of a policy over time, the blending of overlapping chunks, and the motion that follows targets within limits.

Pure logic: times are arguments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from robot.trajectory import MotionLimits, Trajectory, Vector, bridge

# Time between two samples of the motion; the cubics between them are exact while the jerk does not change [s].
SAMPLE_S = 0.02

# Windows over which targets are averaged, the first that keeps the limits; 0 for none [samples]. A policy sends 30 Hz:
# its noise of 0.05 rad asks for 80 rad/s^2.
WINDOWS = (0, 3, 5, 9, 17, 33)

# Targets that are over are kept for the averages this long: the widest window takes 0.68 s of them [s].
KEPT_S = 2.0

# Share of the acceleration limit that averaged targets may use: the rest closes the way to them.
ACCELERATION_SHARE = 0.7

# A distance from the targets shrinks to a third in this time [s], and never faster than with this share of the
# acceleration limit.
CLOSING_S = 0.06
CLOSING_SHARE = 0.5

# Time by which the arm begins to brake earlier than a joint at full braking would have to [s].
BRAKES_EARLIER_S = 0.04
BRAKING_SHARE = 0.75


class Blend(StrEnum):
    """Ways to join a chunk with the one before it, where both have targets."""

    REPLACE = "replace"  # the new chunk counts
    ENSEMBLE = "ensemble"  # the mean of both, with the weight of the new chunk
    REAL_TIME = "real_time"  # from the former chunk to the new one, by the weights of real-time chunking


@dataclass(frozen=True)
class Targets:
    """Positions of some joints over time, straight between the points."""

    joint_names: tuple[str, ...]
    time_s: Vector  # monotonic, increasing, shape (n,) [s]
    positions_rad: Vector  # shape (n, joints) [rad]

    @property
    def end_s(self) -> float:
        """Time of the last point [s]."""
        return float(self.time_s[-1])

    def at(self, time_s: Vector) -> Vector:
        """Return the positions at some times, shape (m, joints) [rad]; those before and after are held."""
        places = np.interp(time_s, self.time_s, np.arange(len(self.time_s)))
        before = places.astype(np.intp)
        start, end = self.positions_rad[before], self.positions_rad[np.ceil(places).astype(np.intp)]
        between: Vector = start + (places - before)[:, np.newaxis] * (end - start)
        return between

    def until(self, end_s: float) -> Targets:
        """Return the targets up to a time after the first point [s]."""
        kept = self.time_s < end_s
        time_s = np.append(self.time_s[kept], end_s)
        return Targets(self.joint_names, time_s, np.vstack((self.positions_rad[kept], self.at(np.array([end_s])))))

    def of_joints(self, joint_names: tuple[str, ...]) -> Targets:
        columns = [self.joint_names.index(name) for name in joint_names]
        return Targets(joint_names, self.time_s, self.positions_rad[:, columns])


def blended(former: Targets | None, new: Targets, blend: Blend, weight: float, now_s: float) -> Targets:
    """Return the targets of two chunks of the same joints from now on, after the former ones of the last seconds.

    Args:
        weight: weight of the new chunk in an ensemble, 0 to 1.
    """
    if former is None or former.end_s < new.time_s[0]:
        return new
    first_s = max(now_s, float(new.time_s[0]))
    time_s = np.concatenate(([first_s], new.time_s[new.time_s > first_s]))
    share = np.where(time_s > former.end_s, 1.0, _share_of_new(time_s, blend, weight, first_s, former.end_s))
    positions = share[:, np.newaxis] * new.at(time_s) + (1.0 - share[:, np.newaxis]) * former.at(time_s)
    past = (former.time_s < first_s) & (former.time_s > first_s - KEPT_S)
    return Targets(
        new.joint_names,
        np.concatenate((former.time_s[past], time_s)),
        np.vstack((former.positions_rad[past], positions)),
    )


def _share_of_new(time_s: Vector, blend: Blend, weight: float, first_s: float, end_s: float) -> Vector:
    if blend is Blend.REPLACE:
        return np.ones_like(time_s)
    if blend is Blend.ENSEMBLE:
        return np.full_like(time_s, weight)
    # Black, Galliker, Levine, "Real-Time Execution of Action Chunking Flow Policies", 2025, equation 5: weight of the
    # former chunk, which falls from 1 now to 0 at its end.
    left = np.clip((end_s - time_s) / max(end_s - first_s, SAMPLE_S), 0.0, 1.0)
    share: Vector = 1.0 - left * np.expm1(left) / math.expm1(1.0)
    return share


def follow(targets: Targets, start: tuple[Vector, Vector, Vector], at_s: float, limits: MotionLimits) -> Trajectory:
    """Return the motion that follows targets within limits from a state of the joints, and comes to rest at the last.

    The targets are averaged over the shortest window with which they keep the limits, without a delay; the motion comes
    to them as fast as the limits allow.

    Args:
        start: position, velocity and acceleration, each of shape (joints,) [rad, s].
        at_s: time of the start, before the last target [s].
    """
    names, count = targets.joint_names, max(math.ceil((targets.end_s - at_s) / SAMPLE_S), 0)
    positions, velocities = _averaged(targets, at_s, count, limits)
    brakes = _braking_sample(velocities, limits)
    # Of each joint by itself: numbers of Python are quicker than arrays of a few.
    followed = positions[:brakes].T, velocities[1 : brakes + 1].T, limits.velocity, limits.acceleration, limits.jerk
    columns = zip(*start, *followed, strict=True)
    flat = [_followed(*(each.tolist() for each in column)) for column in columns]
    states = np.array(flat).reshape(len(names), brakes + 1, 3).transpose(1, 2, 0)
    tail = bridge(names, tuple(states[-1]), (targets.positions_rad[-1], np.zeros(len(names))), limits, 0.0)
    return Trajectory(names, SAMPLE_S * np.arange(brakes + 1, dtype=np.float64), *states.transpose(1, 0, 2)).then(tail)


def deviation_rad(targets: Targets, motion: Trajectory, at_s: float) -> Vector:
    """Return the greatest distance of each joint of a motion from its target, shape (joints,) [rad]."""
    wanted = targets.at(at_s + motion.time_s)
    greatest: Vector = np.abs(motion.positions_rad - wanted).max(axis=0)
    return greatest


def _averaged(targets: Targets, at_s: float, count: int, limits: MotionLimits) -> tuple[Vector, Vector]:
    """Return positions and velocities of averaged targets, each of shape (count + 1, joints)."""
    margin = 2 * (WINDOWS[-1] // 2) + 2
    past = min(margin, max(math.floor((at_s - float(targets.time_s[0])) / SAMPLE_S), 0))
    sampled = targets.at(at_s + SAMPLE_S * np.arange(-past, count + 1, dtype=np.float64))
    # Before the first target and beyond the last the joints go on as they come there: the motion itself begins and
    # brakes within the limits.
    sampled = np.pad(sampled, ((margin - past, margin), (0, 0)), mode="reflect", reflect_type="odd")
    for window in WINDOWS:
        positions = sampled
        if window:
            kernel = np.convolve(np.full(window, 1.0 / window), np.full(window, 1.0 / window))
            positions = np.stack([np.convolve(column, kernel, mode="same") for column in sampled.T], axis=-1)
        # Central differences, for which the first sample and the last have no neighbour.
        velocities = (positions[2:] - positions[:-2]) / (2.0 * SAMPLE_S)
        accelerations = (velocities[2:] - velocities[:-2]) / (2.0 * SAMPLE_S)
        kept = positions[margin : margin + count + 1], velocities[margin - 1 : margin + count]
        accelerations = accelerations[margin - 3 : margin + count - 1]
        jerks = np.diff(accelerations, axis=0) / SAMPLE_S
        if (
            (np.abs(kept[1]) <= limits.velocity).all()
            and (np.abs(accelerations[1:]) <= ACCELERATION_SHARE * limits.acceleration).all()
            and (np.abs(jerks) <= limits.jerk).all()
        ):
            break
    return kept


def _braking_sample(velocities: Vector, limits: MotionLimits) -> int:
    """Return the last sample from which every joint can brake before the last target."""
    brakes_s = BRAKES_EARLIER_S + BRAKING_SHARE * (np.abs(velocities) / limits.acceleration).max(axis=1)
    left_s = SAMPLE_S * np.arange(len(velocities) - 1, -1, -1)
    return int(np.flatnonzero(left_s >= brakes_s).max(initial=0))


def _followed(
    position: float,
    velocity: float,
    acceleration: float,
    targets: list[float],
    rates: list[float],
    most_velocity: float,
    most_acceleration: float,
    most_jerk: float,
) -> list[float]:
    """Return position, velocity and acceleration, a sample apart, of a joint that follows targets from now on.

    Args:
        rates: velocities of the targets a sample later.
    """
    states, step = [position, velocity, acceleration], most_jerk * SAMPLE_S
    # Nearer than this the distance shrinks to a third in the time, further away it brakes: both rates are equal there.
    near = 2.0 * CLOSING_SHARE * most_acceleration * CLOSING_S**2
    for target, rate in zip(targets, rates, strict=True):
        error = target - position
        if -near <= error <= near:
            wanted = rate + error / CLOSING_S
        else:
            wanted = rate + math.copysign(math.sqrt(2.0 * CLOSING_SHARE * most_acceleration * abs(error)), error)
        if not -most_velocity <= wanted <= most_velocity:
            wanted = math.copysign(most_velocity, wanted)
        # The jerk does not change within a sample, so that the cubics are exact. The acceleration at its end leads to
        # the wanted velocity if it then falls to 0 in the fewest samples for which the jerk is enough.
        change = wanted - velocity - acceleration * SAMPLE_S / 2.0
        falls = 1
        if abs(change) > step * SAMPLE_S:
            falls = math.ceil((math.sqrt(1.0 + 8.0 * abs(change) / (step * SAMPLE_S)) - 1.0) / 2.0)
        following = 2.0 * change / ((1 + falls) * SAMPLE_S)
        if abs(following) > most_acceleration:
            following = math.copysign(most_acceleration, following)
        if abs(following - acceleration) > step:
            following = acceleration + math.copysign(step, following - acceleration)
        position += SAMPLE_S * (velocity + SAMPLE_S * (2.0 * acceleration + following) / 6.0)
        velocity += SAMPLE_S * (acceleration + following) / 2.0
        acceleration = following
        states += (position, velocity, acceleration)
    return states
