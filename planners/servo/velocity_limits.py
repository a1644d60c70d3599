"""Limits on joint velocities while servoing, and the least-squares problem that is solved within them.

Joint limits and obstacles ahead are inequalities on the velocities: the speed of approach shrinks with the distance,
motion along them and away from them is free. Faverjon and Tournassoud, "A local based approach for path planning of
manipulators with a high number of degrees of freedom", 1987.

Near a singularity, motion into it is slowed and motion out of it is not. Only the part of a command in the weak
direction is concerned, that of the least singular value of the position's Jacobian; the greatest divided by it is the
condition number.

The least-squares problems with inequalities are solved by the primal active-set method: Nocedal and Wright, Numerical
Optimization, 2nd edition, algorithm 16.3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.geometry.nearness import NearPair
from planners.servo.question import ServoLimits, ServoStatus
from robot.trajectory import Vector

# Each step adds or drops one inequality; ten suffice for what an arm meets. What has been found until then is within
# all of them.
MAX_STEPS = 40

# Shorter steps and smaller multipliers are rounding.
ROUNDING = 1e-9

# Time over which a motion is predicted to tell if it approaches a singularity.
PREDICTION_S = 0.005

# The way out of one is of second order, so it takes longer to show.
EXIT_PREDICTION_S = 0.1

# A greater change of the least singular value is no rounding [m/rad].
NOTICED_M_PER_RAD = 1e-6

# Leaving, the tip must get this share of the way it was to go: less is turning about itself.
LEAST_PROGRESS = 0.01

# Speed of approach per distance left. With it a joint at full speed brakes as hard as it can, and no harder.
APPROACH_PER_S = 2.5

# Room for the curvature of the way: a pair's direction holds for the present configuration only. Under random sticks an
# SO-101 came up to 2 mm nearer to a table than without it [m].
CURVATURE_M = 0.003

# Share of the joints' braking that is counted on: several inequalities may need it, and directions change on the way.
BRAKING_SHARE = 0.5

# Periods that pass before a setpoint has its effect: its answer is a period old, and the arm rounds its corners.
BRAKING_DELAY = 1.0

# Price of exceeding an inequality, in changes of the joints' velocities.
EXCESS_PRICE = 30.0

# Pairs further apart than this are watched by an arm that is fast only: they limit no speed below 0.3 m/s.
WATCHED_M = 0.12


@dataclass(frozen=True)
class VelocityBounds:
    """Inequalities ``rows @ velocity <= bounds``; at rest all of them hold.

    Attributes:
        rows: shape (k, n).
        bounds: shape (k,), none below 0.
        pairs: pairs of the last rows; the rows before them are limits of joints.
    """

    rows: Vector
    bounds: Vector
    pairs: Sequence[NearPair]

    def near(self, active: NDArray[np.intp]) -> list[NearPair]:
        """Return the pairs of some inequalities."""
        first = len(self.bounds) - len(self.pairs)
        return [self.pairs[index - first] for index in active if index >= first]

    def joints(self, active: NDArray[np.intp]) -> list[int]:
        """Return the joints whose limits are among some inequalities."""
        count = len(self.rows[0])
        return sorted({int(index) % count for index in active if index < len(self.bounds) - len(self.pairs)})


def watched_m(travel_m_per_rad: Vector, velocity_rad_s: Vector, max_change: Vector, period_s: float) -> float:
    """Return how far ahead obstacles must be known, so that the joints still brake before them [m].

    Args:
        travel_m_per_rad: greatest travel of a point of the arm by each joint, shape (n,) [m/rad].
        velocity_rad_s: present velocities of the joints, shape (n,) [rad/s].
        max_change: of these in a period, shape (n,) [rad/s].
        period_s: time between two answers [s].
    """
    fastest = np.abs(velocity_rad_s) + max_change
    braking = BRAKING_SHARE * max_change / period_s
    ahead_rad = fastest * BRAKING_DELAY * period_s + fastest**2 / (2.0 * braking)
    return max(WATCHED_M, CURVATURE_M + float(travel_m_per_rad @ ahead_rad))


def velocity_bounds(
    q: Vector,
    lower: Vector,
    upper: Vector,
    columns: NDArray[np.intp],
    pairs: Sequence[NearPair],
    limits: ServoLimits,
    max_change: Vector,
    period_s: float,
) -> VelocityBounds:
    """Return the velocity bounds at a configuration.

    The speed of approach is that from which the joints still brake within the room left, a period from now.

    Args:
        q: positions of the joints that may move, shape (n,) [rad].
        lower: their limits, shape (n,) [rad].
        upper: likewise.
        columns: their places in the slopes of pairs.
        pairs: pairs near each other.
        limits: the distances to keep.
        max_change: of the joints' velocities in a period, shape (n,) [rad/s].
        period_s: time between two answers [s].
    """
    kept = [limits.scene_distance_m if pair.by_object else limits.self_distance_m for pair in pairs]
    watched = [(pair, kept_m) for pair, kept_m in zip(pairs, kept, strict=True) if kept_m is not None]
    left_m = np.array([pair.distance_m - kept_m - CURVATURE_M for pair, kept_m in watched])
    slopes = np.array([pair.distance_gradient[columns] for pair, _ in watched]).reshape(-1, len(q))
    room = np.maximum(np.concatenate((upper - q, q - lower, left_m)), 0.0)
    rows = np.vstack((np.eye(len(q)), -np.eye(len(q)), -slopes))
    # With v' = v - change the way to rest is v * period + v^2 / (2 a): solved for v.
    braking = BRAKING_SHARE * (np.abs(rows) @ max_change) / period_s
    lost = braking * BRAKING_DELAY * period_s
    brakes_within = np.sqrt(lost**2 + 2.0 * braking * room) - lost
    return VelocityBounds(rows, np.minimum(APPROACH_PER_S * room, brakes_within), [pair for pair, _ in watched])


def within_reach(wanted: Vector, reach: Vector, rows: Vector, left: Vector) -> Vector:
    """Return the change of velocities nearest to a wanted one that the joints can make, within inequalities.

    Where the inequalities cannot all be met in one step, the joints come as near to that as they can: each inequality
    may be exceeded, at a price (an exact penalty would need no less than the greatest multiplier).

    Args:
        wanted: change that the joints can make, shape (n,) [rad/s].
        reach: greatest change of each joint, shape (n,) [rad/s].
        rows: inequalities ``rows @ change <= left``, shape (k, n).
        left: below 0 where the present velocity exceeds its bound, shape (k,).

    Returns:
        Shape (n,) [rad/s].
    """
    if (rows @ wanted <= left + ROUNDING).all():
        return wanted
    # Only what some change within reach could exceed.
    concerned = np.abs(rows) @ reach > left
    rows, left = rows[concerned], left[concerned]
    size, count = len(wanted), len(left)
    excess = np.maximum(-left, 0.0)
    none = np.zeros((size, count))
    all_rows = np.block([[rows, -np.eye(count)], [np.eye(size), none], [-np.eye(size), none], [none.T, -np.eye(count)]])
    bounds = np.concatenate((left + excess, reach, reach, excess))
    matrix = np.diag(np.concatenate((np.ones(size), np.full(count, EXCESS_PRICE))))
    desired = np.concatenate((wanted, -EXCESS_PRICE * excess))
    found, _ = bounded_least_squares(matrix, desired, ROUNDING, all_rows, bounds)
    return np.asarray(found[:size])


@dataclass(frozen=True)
class PredictedTip:
    """Prediction: the tip's position, shape (3,) [m], and its Jacobian, shape (3, n) [m/rad]."""

    position_m: Vector
    jacobian: Vector


@dataclass(frozen=True)
class RegularizedMotion:
    """Desired velocity without its part into a singularity, and the regular Jacobian to achieve it.

    Attributes:
        linear_m_s: the desired velocity that remains, shape (3,) [m/s].
        jacobian: the position's, made regular, shape (3, n) [m/rad].
        free: directions of the joints that do not move the tip, shape (n, n - 3).
        status: status that the singularity causes.
    """

    linear_m_s: Vector
    jacobian: Vector
    free: Vector
    status: ServoStatus = ServoStatus.NO_WARNING


def regularized(
    jacobian: Vector,
    linear_m_s: Vector,
    limits: ServoLimits,
    max_velocity: Vector,
    predict: Callable[[Vector], PredictedTip],
) -> RegularizedMotion:
    """Remove the part of a desired velocity that leads into a singularity.

    Args:
        jacobian: of the tip's position, shape (3, n), n at least 3 [m/rad].
        linear_m_s: the desired velocity, shape (3,) [m/s].
        limits: condition numbers from which motion is slowed.
        max_velocity: of the joints, shape (n,) [rad/s].
        predict: returns the tip after a motion of the joints, shape (n,) [rad].
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
    """Return the allowed share of a motion in the weak direction."""
    if change > NOTICED_M_PER_RAD:
        return 1.0, ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY
    if condition >= limits.singularity_stop:
        return 0.0, ServoStatus.HALT_FOR_SINGULARITY
    share = (limits.singularity_stop - condition) / (limits.singularity_stop - limits.singularity_slow)
    return share, ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY


def bounded_least_squares(
    matrix: Vector, desired: Vector, damping: float, rows: Vector, bounds: Vector
) -> tuple[Vector, NDArray[np.intp]]:
    """Return the x of least ``|matrix x - desired|^2 + damping^2 |x|^2`` for which ``rows x <= bounds``.

    Args:
        matrix: shape (m, n).
        desired: shape (m,).
        damping: above 0.
        rows: shape (k, n).
        bounds: shape (k,), none below 0: x = 0 is always allowed.

    Returns:
        x, shape (n,), and the indices of the active inequalities.
    """
    size = matrix.shape[1]
    hessian = matrix.T @ matrix + damping**2 * np.eye(size)
    x = np.zeros(size)
    active: list[int] = []
    for _ in range(MAX_STEPS):
        step, multipliers = _step_along(hessian, matrix.T @ desired - hessian @ x, rows[active])
        if len(active) == size or np.abs(step).max() <= ROUNDING:
            if not active or multipliers.min() >= -ROUNDING:
                break
            del active[int(np.argmin(multipliers))]
            continue
        share, blocking = _allowed_share(x, step, rows, bounds, active)
        x = x + share * step
        if blocking is not None:
            active.append(blocking)
    return x, np.array(active, dtype=np.intp)


def _step_along(hessian: Vector, slope: Vector, rows: Vector) -> tuple[Vector, Vector]:
    """Return the best step that keeps to the active inequalities, and the multiplier of each."""
    size, held = len(slope), len(rows)
    system = np.zeros((size + held, size + held))
    system[:size, :size] = hessian
    system[:size, size:] = rows.T
    system[size:, :size] = rows
    solution = np.linalg.solve(system, np.concatenate((slope, np.zeros(held))))
    return np.asarray(solution[:size]), np.asarray(solution[size:])


def _allowed_share(
    x: Vector, step: Vector, rows: Vector, bounds: Vector, active: list[int]
) -> tuple[float, int | None]:
    """Return the allowed share of a step, and the first inequality that blocks the rest."""
    gain = rows @ step
    gain[active] = 0.0
    towards = np.flatnonzero(gain > ROUNDING * max(1.0, float(np.abs(step).max())))
    if not towards.size:
        return 1.0, None
    shares = np.maximum(bounds[towards] - rows[towards] @ x, 0.0) / gain[towards]
    first = int(np.argmin(shares))
    return (1.0, None) if shares[first] >= 1.0 else (float(shares[first]), int(towards[first]))
