"""Trajectories: joint positions over time, profiles from one state to another, and the reasons to refuse a trajectory.

The arm process refuses trajectories by these reasons, since it trusts no numbers of the server; the server does so
before it sends any.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate, chain, pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from ruckig import ControlInterface, InputParameter, Ruckig, Synchronization
from ruckig import Trajectory as Profile

if TYPE_CHECKING:
    from robot.description.limits import JointBounds

Vector = NDArray[np.float64]

PERIOD_S = 0.01  # period of the control loop, which plays trajectories tick by tick [s]

# Bridges take a tick at least: without that ruckig found no profile for 161 of 20,000 drawn ones. Nearly all had joints
# at rest with a velocity by rounding, such as 1e-15 rad/s.
LEAST_BRIDGE_S = 0.01

LEAST_LIMIT = 1e-8  # limits below it are taken as it: ruckig finds no profile for some of them

# Acceleration reaches its limit within two ticks, in bridges and streams. Joints that reverse then follow their
# velocities so closely that what steering keeps away from stays away: with 0.06 s, random sticks drove a Koch v1.1 3 mm
# into a table that is kept 5 mm away (40 runs of 3.2 s, 10 of them nearer than 5 mm); with 0.02 s no run came nearer
# than 7.2 mm.
TIME_TO_FULL_ACCELERATION_S = 2.0 * PERIOD_S


@dataclass(frozen=True)
class Trajectory:
    """Joint positions over time with continuous velocity."""

    joint_names: tuple[str, ...]  # joint of each column
    time_s: Vector  # shape (n,), n >= 1, strictly increasing from 0 [s]
    positions_rad: Vector  # shape (n, joints) [rad]
    velocities_rad_s: Vector  # shape (n, joints) [rad/s]
    accelerations_rad_s2: Vector  # shape (n, joints) [rad/s^2]

    @property
    def duration_s(self) -> float:
        return float(self.time_s[-1])

    @property
    def peak_speed_rad_s(self) -> Vector:
        """Greatest speed of each joint, also between the samples, shape (joints,) [rad/s]."""
        peaks = np.abs(self.velocities_rad_s).max(axis=0)
        span_s = np.diff(self.time_s)[:, None]
        m0, m1 = self.velocities_rad_s[:-1] * span_s, self.velocities_rad_s[1:] * span_s
        way = np.diff(self.positions_rad, axis=0)
        c2, c3 = 3.0 * way - 2.0 * m0 - m1, m0 + m1 - 2.0 * way
        # The velocity is a parabola between two samples: its vertex counts where it lies between them.
        curved = np.abs(c3) > 1e-12
        u = np.divide(-c2, 3.0 * c3, where=curved, out=np.zeros_like(c3))
        vertex = np.where(curved & (u > 0.0) & (u < 1.0), np.abs(m0 + u * c2) / span_s, 0.0)
        greatest: Vector = np.maximum(peaks, vertex.max(axis=0, initial=0.0))
        return greatest

    def of_joints(self, joint_names: tuple[str, ...]) -> Trajectory:
        """Return the same motion of some of its joints, in their order."""
        columns = [self.joint_names.index(name) for name in joint_names]
        arrays = self.positions_rad, self.velocities_rad_s, self.accelerations_rad_s2
        return Trajectory(joint_names, self.time_s, *(array[:, columns] for array in arrays))

    def then(self, motion: Trajectory) -> Trajectory:
        """Return this motion followed by one of the same joints, which begins where this one ends."""
        return Trajectory(
            self.joint_names,
            np.concatenate((self.time_s, motion.time_s[1:] + self.duration_s)),
            np.vstack((self.positions_rad, motion.positions_rad[1:])),
            np.vstack((self.velocities_rad_s, motion.velocities_rad_s[1:])),
            np.vstack((self.accelerations_rad_s2, motion.accelerations_rad_s2[1:])),
        )

    def sample(self, time_s: float) -> tuple[Vector, Vector, Vector]:
        """Interpolate by cubic Hermite polynomials: position, velocity and acceleration, each of shape (joints,)."""
        if time_s >= self.duration_s:
            return self.positions_rad[-1], self.velocities_rad_s[-1], self.accelerations_rad_s2[-1]
        if time_s <= 0.0:
            return self.positions_rad[0], self.velocities_rad_s[0], self.accelerations_rad_s2[0]
        i = int(np.searchsorted(self.time_s, time_s, side="right")) - 1
        span_s = self.time_s[i + 1] - self.time_s[i]
        u = (time_s - self.time_s[i]) / span_s
        p0, p1 = self.positions_rad[i], self.positions_rad[i + 1]
        m0, m1 = self.velocities_rad_s[i] * span_s, self.velocities_rad_s[i + 1] * span_s
        c2 = 3.0 * (p1 - p0) - 2.0 * m0 - m1
        c3 = 2.0 * (p0 - p1) + m0 + m1
        position = p0 + u * (m0 + u * (c2 + u * c3))
        velocity = (m0 + u * (2.0 * c2 + 3.0 * u * c3)) / span_s
        acceleration = (2.0 * c2 + 6.0 * u * c3) / span_s**2
        return position, velocity, acceleration


@dataclass(frozen=True)
class MotionLimits:
    """Limits of the joints of a motion, each of shape (joints,)."""

    velocity: Vector  # [rad/s]
    acceleration: Vector  # [rad/s^2]
    jerk: Vector  # [rad/s^3]


def bridge(
    joint_names: tuple[str, ...],
    start: tuple[Vector, Vector, Vector],
    end: tuple[Vector, Vector],
    limits: MotionLimits,
    least_s: float,
) -> Trajectory:
    """Plan the motion from one state of the joints to another within limits, in a time or as fast as the limits allow.

    The start has position, velocity and acceleration, the end position (NaN: at rest anywhere) and velocity. The
    profile is ruckig's; raises RuckigError where it finds none.
    """
    joints = len(joint_names)
    position, velocity, acceleration = start
    max_velocity, max_acceleration = limits.velocity, limits.acceleration
    given, profile = InputParameter(joints), Profile(joints)
    given.current_position, given.current_velocity = position.tolist(), velocity.tolist()
    given.current_acceleration = np.clip(acceleration, -max_acceleration, max_acceleration).tolist()
    stopping = np.isnan(end[0])
    given.target_position = np.where(stopping, position, end[0]).tolist()
    given.target_velocity = np.where(stopping, 0.0, np.clip(end[1], -max_velocity, max_velocity)).tolist()
    # A joint may be faster already: the limits may have changed since.
    given.max_velocity = np.maximum(max_velocity, np.abs(velocity)).tolist()
    given.max_acceleration = max_acceleration.tolist()
    given.max_jerk = limits.jerk.tolist()
    # Joints that come to rest do so by then, so that none goes on after the end.
    rests_s = np.abs(velocity) / max_acceleration + 2.0 * max_acceleration / limits.jerk
    given.minimum_duration = max(least_s, LEAST_BRIDGE_S, float(np.max(rests_s, where=stopping, initial=0.0)))
    interfaces = ControlInterface.Position, ControlInterface.Velocity
    given.per_dof_control_interface = [interfaces[int(each)] for each in stopping]
    given.per_dof_synchronization = [Synchronization.No if each else Synchronization.Time for each in stopping]
    Ruckig(joints).calculate(given, profile)
    return _of_profile(joint_names, profile)


def rest_to_rest(
    joint: str, start_rad: float, end_rad: float, max_velocity: float, max_acceleration: float
) -> Trajectory:
    """Plan the fastest motion of one joint from rest to rest: a trapezoid of its velocity."""
    given, profile = InputParameter(1), Profile(1)
    given.current_position, given.target_position = [start_rad], [end_rad]
    given.max_velocity, given.max_acceleration = [max(max_velocity, LEAST_LIMIT)], [max(max_acceleration, LEAST_LIMIT)]
    Ruckig(1).calculate(given, profile)
    return _of_profile((joint,), profile)


def _of_profile(joint_names: tuple[str, ...], profile: Profile) -> Trajectory:
    # Between the corners of all joints' profiles the positions are cubics; corners within a microsecond are one.
    ends = (accumulate((*each.brake.t, *each.t)) for each in profile.profiles[0])
    corners = sorted({0.0, *chain.from_iterable(ends)})
    kept = [corner for before, corner in pairwise((-1.0, *corners)) if corner - before > 1e-6]
    times_s = [*(corner for corner in kept if corner < profile.duration - 1e-6), profile.duration]
    times_s[0] = 0.0
    columns = (np.array(each) for each in zip(*map(profile.at_time, times_s), strict=True))
    return Trajectory(joint_names, np.array(times_s), *columns)


# A trajectory may start this far from the held position [rad]; the step bound smooths the difference.
START_TOLERANCE_RAD = 0.05

LIMIT_TOLERANCE_RAD = 0.002  # goals may exceed a limit by this much [rad]: rounding to ticks is 0.0015 rad
VELOCITY_TOLERANCE = 1.05  # timing laws meet velocity limits only to a few per cent between their grid points

# A profile that switches from full acceleration to full braking between two samples keeps the limit, but the cubic
# through them has up to 5/3 of it: 8x - 6x^2 - 1 at the first sample, for a switch at the share x of the time between.
ACCELERATION_TOLERANCE = 1.7

MAX_SAMPLES = 180_000  # 100 Hz for half an hour


def refusal(
    trajectory: Trajectory, names: tuple[str, ...], bounds: JointBounds, held_rad: Vector, *, in_motion: bool = False
) -> str:
    """Check a trajectory; return the reason to refuse it, empty for none.

    The curve between the samples is checked, from the goals at which the arm holds, shape (joints,) [rad]; it begins at
    rest unless it continues a motion.
    """
    malformed = _malformed(trajectory, names)
    if malformed:
        return malformed
    columns = np.array([names.index(name) for name in trajectory.joint_names])
    chosen, held = bounds.of_columns(columns), held_rad[columns]
    away = np.abs(trajectory.positions_rad[0] - held)
    if away.max() > START_TOLERANCE_RAD:
        column = int(np.argmax(away))
        return (
            f"the motion starts with joint {trajectory.joint_names[column]} at "
            f"{trajectory.positions_rad[0, column]:.3f} rad, but the arm holds it at {held[column]:.3f} rad "
            f"(tolerance {START_TOLERANCE_RAD} rad)"
        )
    return _rest_refusal(trajectory, chosen, in_motion=in_motion) or _curve_refusal(trajectory, chosen, held)


def names_refusal(names: tuple[str, ...], known: tuple[str, ...]) -> str:
    """Check the names of joints to move together; return the reason to refuse them, empty for none."""
    if names and set(names) <= set(known) and len(set(names)) == len(names):
        return ""
    return f"the motion names the joints {list(names)}; the arm has {list(known)}, each at most once"


def _rest_refusal(trajectory: Trajectory, bounds: JointBounds, *, in_motion: bool) -> str:
    """Check that a trajectory begins and ends at rest; its joints would change their speed within a tick."""
    limits = ACCELERATION_TOLERANCE * bounds.max_acceleration * PERIOD_S
    for sample, word in ((-1, "end"),) if in_motion else ((0, "begin"), (-1, "end")):
        speeds = np.abs(trajectory.velocities_rad_s[sample])
        column = int(np.argmax(speeds - limits))
        if speeds[column] > limits[column]:
            return (
                f"joint {trajectory.joint_names[column]} would {word} at {trajectory.time_s[sample]:.3f} s with "
                f"{speeds[column]:.2f} rad/s; it must be at rest there (tolerance {limits[column]:.2f} rad/s)"
            )
    return ""


def _curve_refusal(trajectory: Trajectory, bounds: JointBounds, held_rad: Vector) -> str:
    # An arm that was switched on outside its soft limits may be brought back inside.
    lower = np.minimum(bounds.lower_rad, held_rad) - LIMIT_TOLERANCE_RAD
    upper = np.maximum(bounds.upper_rad, held_rad) + LIMIT_TOLERANCE_RAD
    fastest = bounds.max_velocity * VELOCITY_TOLERANCE
    strongest = bounds.max_acceleration * ACCELERATION_TOLERANCE
    positions, velocities, accelerations = _control_points(trajectory)
    spans, columns = np.nonzero(
        ((positions < lower) | (positions > upper)).any(axis=0)
        | (np.abs(velocities) > fastest).any(axis=0)
        | (np.abs(accelerations) > strongest).any(axis=0)
    )
    at_s, position, velocity, acceleration = _extremes(trajectory, spans, columns)
    speed, change = np.abs(velocity), np.abs(acceleration)
    outside = (position < lower[columns, np.newaxis]) | (position > upper[columns, np.newaxis])
    too_fast, too_strong = speed > fastest[columns, np.newaxis], change > strongest[columns, np.newaxis]
    for wrong in (outside, too_fast, too_strong):
        if not wrong.any():
            continue
        index = tuple(np.argwhere(wrong)[0])
        column = columns[index[0]]
        who, when = f"joint {trajectory.joint_names[column]} would", f"at {at_s[index]:.3f} s"
        if wrong is outside:
            return (
                f"{who} go to {position[index]:.3f} rad, beyond its limits {lower[column]:.3f} to "
                f"{upper[column]:.3f} rad, {when}"
            )
        if wrong is too_fast:
            return f"{who} move at {speed[index]:.2f} rad/s, above its limit of {fastest[column]:.2f} rad/s, {when}"
        limit = f"its limit of {strongest[column]:.2f} rad/s^2"
        return f"{who} accelerate by {change[index]:.2f} rad/s^2, above {limit}, {when}"
    return ""


def _control_points(trajectory: Trajectory) -> tuple[Vector, Vector, Vector]:
    """Return the Bezier control points of each span's positions, velocities and accelerations: 4, 3 and 2 a span.

    The curve stays between them, so a span whose control points keep the limits keeps them. Source: Farin, Curves and
    Surfaces for CAGD, 5th edition, 4.3 (convex hull property) and 5.3 (derivatives). Each array has the shape (points,
    spans, joints).
    """
    positions, velocities = trajectory.positions_rad, trajectory.velocities_rad_s
    if len(positions) == 1:
        return positions[np.newaxis], velocities[np.newaxis], np.zeros((1, 1, positions.shape[1]))
    third_s = np.diff(trajectory.time_s)[:, np.newaxis] / 3.0
    first, last = positions[:-1], positions[1:]
    hull = np.stack((first, first + third_s * velocities[:-1], last - third_s * velocities[1:], last))
    speeds = np.diff(hull, axis=0) / third_s
    return hull, speeds, np.diff(speeds, axis=0) / (1.5 * third_s)


def _extremes(
    trajectory: Trajectory, spans: NDArray[np.intp], columns: NDArray[np.intp]
) -> tuple[Vector, Vector, Vector, Vector]:
    """Return the curve where it may be extreme: at the ends of spans, and where velocity or acceleration is zero.

    Spans, by the index of their first sample, and their joints have shape (k,). Times [s], positions [rad], velocities
    [rad/s] and accelerations [rad/s^2] have shape (k, 5).
    """
    ends = np.minimum(spans + 1, len(trajectory.time_s) - 1)
    # The one sample of a trajectory without spans is at rest.
    span_s = np.where(ends > spans, trajectory.time_s[ends] - trajectory.time_s[spans], 1.0)
    first = trajectory.positions_rad[spans, columns]
    rise = trajectory.positions_rad[ends, columns] - first
    m0, m1 = (span_s * trajectory.velocities_rad_s[sample, columns] for sample in (spans, ends))
    # As Trajectory.sample interpolates.
    c2, c3 = 3.0 * rise - 2.0 * m0 - m1, m0 + m1 - 2.0 * rise
    with np.errstate(divide="ignore", invalid="ignore"):
        # Both roots without a difference of near numbers: Press et al., Numerical Recipes, 3rd edition, 5.6.
        larger = -(c2 + np.copysign(np.sqrt(c2**2 - 3.0 * c3 * m0), c2))
        turns = np.column_stack((-c2 / (3.0 * c3), larger / (3.0 * c3), m0 / larger))
    inside = np.where((turns > 0.0) & (turns < 1.0), turns, 0.0)
    u = np.column_stack((np.zeros_like(c2), np.ones_like(c2), inside))
    first, m0, c2, c3, span_s = (array[:, np.newaxis] for array in (first, m0, c2, c3, span_s))
    return (
        trajectory.time_s[spans, np.newaxis] + u * span_s,
        first + u * (m0 + u * (c2 + u * c3)),
        (m0 + u * (2.0 * c2 + 3.0 * u * c3)) / span_s,
        (2.0 * c2 + 6.0 * u * c3) / span_s**2,
    )


def _malformed(trajectory: Trajectory, known: tuple[str, ...]) -> str:
    names = trajectory.joint_names
    if reason := names_refusal(names, known):
        return reason
    samples = trajectory.time_s.shape[0]
    if not 1 <= samples <= MAX_SAMPLES:
        return f"the motion has {samples} samples; 1 to {MAX_SAMPLES} are allowed"
    for array in (trajectory.positions_rad, trajectory.velocities_rad_s, trajectory.accelerations_rad_s2):
        if array.shape != (samples, len(names)):
            return f"the motion has an array of shape {array.shape} for {samples} samples of {len(names)} joints"
        if not np.isfinite(array).all():
            return "the motion holds a value that is not a finite number"
    if not np.isfinite(trajectory.time_s).all() or trajectory.time_s[0] != 0.0:
        return "the times of the motion must be finite numbers from 0 on"
    if not (np.diff(trajectory.time_s) > 0.0).all():
        return "the times of the motion must increase from 0"
    return ""
