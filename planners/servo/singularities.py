"""Motion of the tip near singularities: motion into one is slowed, and motion out of it is free.

Only the part of a command in the weak direction is concerned, which belongs to the least singular value of the
position's Jacobian; the greatest singular value divided by the least one is the condition number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planners.servo.question import ServoLimits, ServoStatus
from robot.trajectory import Vector

# Time over which a motion is predicted to tell if it approaches a singularity.
PREDICTION_S = 0.005

# The way out of one is of second order, so it takes longer to show.
EXIT_PREDICTION_S = 0.1

# A greater change of the least singular value is no rounding [m/rad].
NOTICED_M_PER_RAD = 1e-6

# Leaving, the tip must get this share of the way it was to go: less is turning about itself.
LEAST_PROGRESS = 0.01


@dataclass(frozen=True)
class PredictedTip:
    """Prediction: the tip's position, shape (3,) [m], and its Jacobian, shape (3, n) [m/rad]."""

    position_m: Vector
    jacobian: Vector


@dataclass(frozen=True)
class RegularizedMotion:
    """Desired velocity without its part into a singularity, and the regular Jacobian to achieve it."""

    linear_m_s: Vector  # the desired velocity that remains, shape (3,) [m/s]
    jacobian: Vector  # the position's, made regular, shape (3, n) [m/rad]
    free: Vector  # directions of the joints that do not move the tip, shape (n, n - 3)
    status: ServoStatus = ServoStatus.NO_WARNING  # status that the singularity causes


def regularized(
    jacobian: Vector,
    linear_m_s: Vector,
    limits: ServoLimits,
    max_velocity: Vector,
    predict: Callable[[Vector], PredictedTip],
) -> RegularizedMotion:
    """Remove the part of a desired velocity of the tip, shape (3,) [m/s], that leads into a singularity.

    The Jacobian of the tip's position has the shape (3, n), n at least 3 [m/rad]; ``predict`` returns the tip after a
    motion of the joints, shape (n,) [rad].
    """
    left, values, right = np.linalg.svd(jacobian)
    free = np.ascontiguousarray(right[3:].T)
    least = values[0] / limits.singularity_stop
    if values[2] * limits.singularity_slow >= values[0]:
        return RegularizedMotion(linear_m_s, jacobian, free)
    floor = np.array([values[0], max(values[1], least), max(values[2], least)])
    sound = (left * floor) @ right[:3]
    weak = left[:, 2]
    desired = float(weak @ linear_m_s)
    velocity = right[:3].T @ ((left.T @ linear_m_s) / floor)
    fastest = float(np.max(np.abs(velocity) / max_velocity))
    velocity = velocity / max(fastest, 1.0)
    change = _least_value(predict(PREDICTION_S * velocity)) - float(values[2])
    share, status = _share(float(values[0] / max(values[2], 1e-12)), change, limits)
    moved_m = predict(EXIT_PREDICTION_S * velocity).position_m - predict(0.0 * velocity).position_m
    if (
        change > NOTICED_M_PER_RAD
        and float(weak @ moved_m) * np.sign(desired) < LEAST_PROGRESS * abs(desired) * EXIT_PREDICTION_S
    ):
        share, status = 0.0, ServoStatus.HALT_FOR_SINGULARITY
    if abs(desired) <= LEAST_PROGRESS * float(np.linalg.norm(linear_m_s)):
        status = ServoStatus.NO_WARNING
    return RegularizedMotion(linear_m_s - (1.0 - share) * desired * weak, sound, free, status)


def _least_value(there: PredictedTip) -> float:
    return float(np.linalg.svd(there.jacobian, compute_uv=False)[2])


def _share(condition: float, change: float, limits: ServoLimits) -> tuple[float, ServoStatus]:
    if change > NOTICED_M_PER_RAD:
        return 1.0, ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY
    if condition >= limits.singularity_stop:
        return 0.0, ServoStatus.HALT_FOR_SINGULARITY
    share = (limits.singularity_stop - condition) / (limits.singularity_stop - limits.singularity_slow)
    return share, ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY
