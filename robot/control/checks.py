"""Checks of the server's configuration and of every trajectory, whose numbers the arm process does not trust."""

import logging
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robot.control.pacing import PERIOD_S
from robot.description.limits import JointBounds
from robot.messages import ArmConfig, GuardLimits
from robot.trajectory import Trajectory, Vector

log = logging.getLogger("armbridge.arm")

# A trajectory may start this far from the held position [rad]; the step bound smooths the difference.
START_TOLERANCE_RAD = 0.05

LIMIT_TOLERANCE_RAD = 0.002  # goals may exceed a limit by this much [rad]: rounding to ticks is 0.0015 rad
VELOCITY_TOLERANCE = 1.05  # timing laws meet velocity limits only to a few per cent between their grid points

# A profile that switches from full acceleration to full braking between two samples keeps the limit, but the cubic
# through them has up to 5/3 of it: 8x - 6x^2 - 1 at the first sample, for a switch at the share x of the time between.
ACCELERATION_TOLERANCE = 1.7

MAX_SAMPLES = 180_000  # 100 Hz for half an hour


def checked(config: ArmConfig) -> ArmConfig:
    """Return the configuration with every number that is out of its range replaced by its default."""
    guard_limits = replace(config.guard_limits, **_corrections(config.guard_limits))
    return replace(config, guard_limits=guard_limits, **_corrections(config))


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


def _corrections(values: ArmConfig | GuardLimits) -> dict[str, Any]:
    """Return the defaults of the values that are out of their ranges, by field; NaN is out of every range."""
    found = {}
    for field in filter(lambda field: field.metadata, fields(values)):
        least, most = field.metadata["range"]
        if not least <= getattr(values, field.name) <= most:
            log.error("%s must be %g to %g; it is taken as %g", field.name, least, most, field.default)
            found[field.name] = field.default
    return found


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
