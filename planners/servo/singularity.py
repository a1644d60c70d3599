"""Where the tip can hardly be moved in one direction: motion into there is slowed, motion out of there is not.

Only the part of a wish in the weak direction is concerned. The weak direction is that of the least singular value of
the position's Jacobian; the greatest divided by it is the condition number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.servo.question import ServoLimits, ServoStatus

Vector = NDArray[np.float64]

# Whether the arm nears a singularity is seen in the next moment.
NEXT_S = 0.005

# Whether it gets out of one is seen later: the way out is of second order.
LATER_S = 0.1

# A greater change of the least singular value is no rounding [m/rad].
NOTICED_M_PER_RAD = 1e-6

# Leaving, the tip must get this share of the way it was to go: less is turning about itself.
LEAST_PROGRESS = 0.01


@dataclass(frozen=True)
class Ahead:
    """How it will be: the tip's position, shape (3,) [m], and its Jacobian, shape (3, n) [m/rad]."""

    position_m: Vector
    jacobian: Vector


@dataclass(frozen=True)
class Regular:
    """A wish that can be had, and the matrix to have it with.

    Attributes:
        linear_m_s: the wish, without what must not be, shape (3,) [m/s].
        jacobian: the position's, made regular, shape (3, n) [m/rad].
        free: directions of the joints that do not move the tip, shape (n, n - 3).
        status: what was done.
    """

    linear_m_s: Vector
    jacobian: Vector
    free: Vector
    status: ServoStatus = ServoStatus.NO_WARNING


def regular(
    jacobian: Vector, linear_m_s: Vector, limits: ServoLimits, max_velocity: Vector, ahead: Callable[[Vector], Ahead]
) -> Regular:
    """Take out of a wish what leads into a singularity.

    Args:
        jacobian: of the tip's position, shape (3, n), n at least 3 [m/rad].
        linear_m_s: the wish, shape (3,) [m/s].
        limits: condition numbers from which motion is slowed.
        max_velocity: of the joints, shape (n,) [rad/s].
        ahead: how it will be after the joints have moved, shape (n,) [rad].
    """
    left, values, right = np.linalg.svd(jacobian)
    free = np.ascontiguousarray(right[3:].T)
    least = values[0] / limits.singularity_stop
    if values[2] * limits.singularity_slow >= values[0]:
        return Regular(linear_m_s, jacobian, free)
    floor = np.array([values[0], max(values[1], least), max(values[2], least)])
    sound = (left * floor) @ right[:3]
    weak = left[:, 2]
    wanted = float(weak @ linear_m_s)
    velocity = right[:3].T @ ((left.T @ linear_m_s) / floor)
    fastest = float(np.max(np.abs(velocity) / max_velocity))
    velocity = velocity / max(fastest, 1.0)
    change = _least_value(ahead(NEXT_S * velocity)) - float(values[2])
    share, status = _share(float(values[0] / max(values[2], 1e-12)), change, limits)
    moved_m = ahead(LATER_S * velocity).position_m - ahead(0.0 * velocity).position_m
    if change > NOTICED_M_PER_RAD and float(weak @ moved_m) * np.sign(wanted) < LEAST_PROGRESS * abs(wanted) * LATER_S:
        share, status = 0.0, ServoStatus.HALT_FOR_SINGULARITY
    if abs(wanted) <= LEAST_PROGRESS * float(np.linalg.norm(linear_m_s)):
        status = ServoStatus.NO_WARNING
    return Regular(linear_m_s - (1.0 - share) * wanted * weak, sound, free, status)


def _least_value(there: Ahead) -> float:
    return float(np.linalg.svd(there.jacobian, compute_uv=False)[2])


def _share(condition: float, change: float, limits: ServoLimits) -> tuple[float, ServoStatus]:
    """How much of a motion in the weak direction is allowed."""
    if change > NOTICED_M_PER_RAD:
        return 1.0, ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY
    if condition >= limits.singularity_stop:
        return 0.0, ServoStatus.HALT_FOR_SINGULARITY
    share = (limits.singularity_stop - condition) / (limits.singularity_stop - limits.singularity_slow)
    return share, ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY
