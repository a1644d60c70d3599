"""Whether a trajectory may be played: every reason to refuse one, each naming joint, limit and value."""

from __future__ import annotations

import numpy as np

from robot.limits import JointBounds
from robot.trajectory import Trajectory, Vector

# A trajectory may start this far from where the arm holds [rad]; the step bound levels the difference.
START_TOLERANCE_RAD = 0.05

# Goals within this much of a limit count as on it: rounding to ticks is 0.0015 rad.
LIMIT_TOLERANCE_RAD = 0.002

# Timing laws meet velocity limits only to a few per cent between their grid points.
VELOCITY_TOLERANCE = 1.05

# 100 Hz for half an hour.
MAX_SAMPLES = 180_000


def refusal(trajectory: Trajectory, names: tuple[str, ...], bounds: JointBounds, held_rad: Vector) -> str:
    """Why a trajectory may not be played, or an empty text.

    Args:
        trajectory: what is asked for.
        names: the arm's joints, order of the arrays.
        bounds: limits of the joints.
        held_rad: where the arm holds, shape (joints,) [rad].
    """
    malformed = _malformed(trajectory, names)
    if malformed:
        return malformed
    for column, name in enumerate(trajectory.joint_names):
        reason = _joint_refusal(trajectory, column, bounds, names.index(name), held_rad)
        if reason:
            return reason
    return ""


def _joint_refusal(trajectory: Trajectory, column: int, bounds: JointBounds, joint: int, held_rad: Vector) -> str:
    name, positions, held = trajectory.joint_names[column], trajectory.positions_rad[:, column], held_rad[joint]
    # An arm that was switched on outside its soft limits may be brought back inside.
    lower = min(bounds.lower_rad[joint], held) - LIMIT_TOLERANCE_RAD
    upper = max(bounds.upper_rad[joint], held) + LIMIT_TOLERANCE_RAD
    outside = positions[(positions < lower) | (positions > upper)]
    if outside.size:
        return f"joint {name} would go to {outside[0]:.3f} rad, beyond its limits {lower:.3f} to {upper:.3f} rad"
    if abs(positions[0] - held) > START_TOLERANCE_RAD:
        return (
            f"the motion starts with joint {name} at {positions[0]:.3f} rad, but the arm holds it at "
            f"{held:.3f} rad (tolerance {START_TOLERANCE_RAD} rad)"
        )
    speeds = np.abs(np.diff(positions)) / np.diff(trajectory.time_s)
    limit = bounds.max_velocity[joint] * VELOCITY_TOLERANCE
    if speeds.size and speeds.max() > limit:
        return f"joint {name} would move at {speeds.max():.2f} rad/s, above its limit of {limit:.2f} rad/s"
    return ""


def names_refusal(names: tuple[str, ...], known: tuple[str, ...]) -> str:
    """Why joints of these names cannot be moved together, or an empty text.

    Args:
        names: what is asked for.
        known: the arm's joints.
    """
    if names and set(names) <= set(known) and len(set(names)) == len(names):
        return ""
    return f"the motion names the joints {list(names)}; the arm has {list(known)}, each at most once"


def _malformed(trajectory: Trajectory, known: tuple[str, ...]) -> str:
    """What is wrong with the form of a trajectory, or an empty text."""
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
