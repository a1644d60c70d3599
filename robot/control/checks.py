"""Checks of what the server sends: its configuration, and every trajectory before it is played.

The arm process relies on its own guards, so it does not trust the server's numbers. A value of the configuration that
is out of range is replaced by its default; a trajectory is refused with a sentence that names joint, limit and value.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, TypeAlias

import numpy as np

from robot.description.limits import JointBounds
from robot.messages import MIN_SPEED_LIMIT, ArmConfig, GuardLimits
from robot.trajectory import Trajectory, Vector

log = logging.getLogger("armbridge.arm")

Ranges: TypeAlias = Mapping[str, tuple[float, float]]

CONFIG_RANGES: Ranges = {
    "state_rate_hz": (1.0, 100.0),
    # Heartbeats come every 0.1 s: the shortest timeout tolerates two missed ones.
    "watchdog_s": (0.3, 10.0),
    # The servos protect themselves at 70 degC.
    "warn_temperature_c": (30.0, 70.0),
    "slow_temperature_c": (30.0, 70.0),
    "stop_temperature_c": (30.0, 70.0),
    "speed_limit": (MIN_SPEED_LIMIT, 1.0),
}

GUARD_RANGES: Ranges = {
    # With less the arm does not hold itself.
    "torque_limit": (0.3, 0.8),
    "gripper_torque_limit": (0.2, 0.5),
    "tracking_error_rad": (0.1, 1.0),
    "tracking_time_s": (0.05, 1.0),
    "stall_current_a": (0.3, 2.7),
    # The servo's own overload timer runs out at 2 s.
    "stall_time_s": (0.1, 1.5),
    # Single packets get lost, and nothing is known of a joint that does not answer.
    "silent_after_s": (0.05, 1.0),
    # Servos of 7.4 V need 4 V, those of 12 V run from 9 V on.
    "min_voltage_v": (4.0, 11.0),
    # Backlash keeps a joint from coming any nearer.
    "goal_tolerance_rad": (0.02, 0.3),
    "settle_timeout_s": (0.1, 10.0),
}

# A trajectory may start this far from the held position [rad]; the step bound smooths the difference.
START_TOLERANCE_RAD = 0.05

# Goals may exceed a limit by this much [rad]: rounding to ticks is 0.0015 rad.
LIMIT_TOLERANCE_RAD = 0.002

# Timing laws meet velocity limits only to a few per cent between their grid points.
VELOCITY_TOLERANCE = 1.05

# 100 Hz for half an hour.
MAX_SAMPLES = 180_000


def checked(config: ArmConfig) -> ArmConfig:
    """Return the configuration with every number that is out of its range replaced by its default."""
    return replace(
        config,
        guard_limits=replace(config.guard_limits, **_corrections(config.guard_limits, GUARD_RANGES)),
        **_corrections(config, CONFIG_RANGES),
    )


def refusal(trajectory: Trajectory, names: tuple[str, ...], bounds: JointBounds, held_rad: Vector) -> str:
    """Check a trajectory; return the reason to refuse it, empty for none.

    Args:
        trajectory: trajectory to play.
        names: the arm's joints, order of the arrays.
        bounds: limits of the joints.
        held_rad: goals at which the arm holds, shape (joints,) [rad].
    """
    malformed = _malformed(trajectory, names)
    if malformed:
        return malformed
    for column, name in enumerate(trajectory.joint_names):
        reason = _joint_refusal(trajectory, column, bounds, names.index(name), held_rad)
        if reason:
            return reason
    return ""


def names_refusal(names: tuple[str, ...], known: tuple[str, ...]) -> str:
    """Check the names of joints to move together; return the reason to refuse them, empty for none.

    Args:
        names: joints to move.
        known: the arm's joints.
    """
    if names and set(names) <= set(known) and len(set(names)) == len(names):
        return ""
    return f"the motion names the joints {list(names)}; the arm has {list(known)}, each at most once"


def _corrections(values: ArmConfig | GuardLimits, ranges: Ranges) -> dict[str, Any]:
    """Return the defaults of the values that are out of their ranges, by field; NaN is out of every range."""
    found = {}
    for field in fields(values):
        least, most = ranges.get(field.name, (0.0, 0.0))
        if field.name in ranges and not least <= getattr(values, field.name) <= most:
            log.error("%s must be %g to %g; it is taken as %g", field.name, least, most, field.default)
            found[field.name] = field.default
    return found


def _joint_refusal(trajectory: Trajectory, column: int, bounds: JointBounds, joint: int, held_rad: Vector) -> str:
    """Check one joint's limits, start and speed; return the reason to refuse the trajectory, empty for none."""
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


def _malformed(trajectory: Trajectory, known: tuple[str, ...]) -> str:
    """Check names, shapes and times of a trajectory; return the reason to refuse it, empty for none."""
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
