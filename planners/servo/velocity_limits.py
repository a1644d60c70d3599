"""Barriers on joint velocities while servoing, and the motion of the tip near singularities.

Joints stay within their limits, and apart from obstacles: the speed of approach shrinks with the distance; motion along
obstacles and away from them is free. Motion into a singularity is slowed, and motion out of it is free. Only the part
of a command in the weak direction is concerned, which belongs to the least singular value of the position's Jacobian;
the greatest singular value divided by the least one is the condition number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.geometry.broadphase import NearPair
from planners.ik.differential import ROUNDING, Limit, Task, barrier, solve
from planners.servo.question import APPROACH_PER_S, ServoLimits, ServoStatus
from robot.trajectory import Vector

# Room for the curvature of the way: a pair's direction holds for the present configuration only. Under random sticks an
# SO-101 came up to 2 mm nearer to a table than without it [m].
CURVATURE_M = 0.003

# Share of the joints' braking that is counted on: several inequalities may need it, and directions change on the way.
BRAKING_SHARE = 0.5

# Cost of exceeding an inequality, in changes of the joints' velocities.
EXCESS_COST = 30.0

# Share of the way to another arm that this arm may use to brake, as the other arm may come as far: Wang, Ames and
# Egerstedt, "Safety barrier certificates for collisions-free multirobot systems", 2017. With the whole way, two
# followers at a latency of 0.095 s came into contact (test_two_followers.py, seed 18).
ROOM_SHARE = 0.5

# Speed of the retreat from another arm that is too near, by the room that is missing [1/s]: two arms that only stop
# creep towards each other under leaders that push them together. In 40 s they came into contact at 0.095 s.
RETREAT_PER_S = 6.0

# A command that leads towards another arm is slowed over this range of distances, down to a share at its lower end:
# at a latency of 0.095 s two arms swung by 0.07 rad beside each other, and came 3 mm nearer than with it [m].
SLOWED_M = (0.006, 0.036)
LEAST_SHARE = 0.15

# Pairs further apart than this are watched by an arm that is fast only: they limit no speed below 0.3 m/s.
WATCHED_M = 0.12


@dataclass(frozen=True)
class VelocityBounds(Limit):
    """Barriers of both limits of each joint, and then of pairs near each other.

    At rest all of them hold, except where another arm is so near that this arm retreats from it.
    """

    pairs: Sequence[NearPair]  # pairs of the last rows

    def near(self, active: NDArray[np.intp]) -> list[NearPair]:
        """Return the pairs of some inequalities."""
        first = len(self.bounds) - len(self.pairs)
        return [self.pairs[index - first] for index in active if index >= first]

    def share_towards_arms(self, velocity_rad_s: Vector) -> float:
        """Return the share of a velocity that the nearest other arm ahead leaves, shape (n,) [rad/s]."""
        ahead = self.rows[len(self.bounds) - len(self.pairs) :] @ velocity_rad_s > 0.0
        near = (pair for pair, nearer in zip(self.pairs, ahead, strict=True) if pair.by_another_arm and nearer)
        return float(np.interp(min((pair.distance_m for pair in near), default=np.inf), SLOWED_M, (LEAST_SHARE, 1.0)))

    def joints(self, active: NDArray[np.intp]) -> list[int]:
        """Return the joints whose limits are among some inequalities."""
        count = len(self.rows[0])
        return sorted({int(index) % count for index in active if index < len(self.bounds) - len(self.pairs)})


def watched_m(travel_m_per_rad: Vector, velocity_rad_s: Vector, max_change: Vector, period_s: float) -> float:
    """Return the distance up to which obstacles must be known, so that the joints still brake before them [m].

    All of the joints have the shape (n,): the greatest travel of a point by each, the present velocities, and the
    greatest change of a velocity in a period.
    """
    fastest = np.abs(velocity_rad_s) + max_change
    braking = BRAKING_SHARE * max_change / period_s
    ahead_rad = fastest * period_s + fastest**2 / (2.0 * braking)
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
    """Return the velocity bounds of the joints that may move, at positions within limits, shape (n,) each [rad].

    ``columns`` are the places of these joints in the gradients of pairs, and ``max_change`` is the greatest change of a
    velocity in a period, shape (n,) [rad/s], after which an answer has its effect.
    """
    kept = [limits.scene_distance_m if pair.by_object else limits.self_distance_m for pair in pairs]
    watched = [(pair, kept_m) for pair, kept_m in zip(pairs, kept, strict=True) if kept_m is not None]
    by_another_arm = np.array([pair.by_another_arm for pair, _ in watched], dtype=bool)
    left_m = np.array([pair.distance_m - kept_m - CURVATURE_M for pair, kept_m in watched])
    left_m = np.where(by_another_arm, ROOM_SHARE * left_m, left_m)
    distance_gradients = np.array([pair.distance_gradient[columns] for pair, _ in watched]).reshape(-1, len(q))
    gradients = np.vstack((-np.eye(len(q)), np.eye(len(q)), distance_gradients))
    distances = np.concatenate((upper - q, q - lower, left_m))
    found = barrier(distances, gradients, BRAKING_SHARE * max_change, period_s, APPROACH_PER_S)
    retreats = RETREAT_PER_S * np.where(by_another_arm, np.minimum(left_m, 0.0), 0.0)
    bounds = found.bounds + np.concatenate((np.zeros(2 * len(q)), retreats))
    return VelocityBounds(found.rows, bounds, [pair for pair, _ in watched])


def within_reach(wanted: Vector, reach: Vector, limit: Limit) -> Vector:
    """Return the nearest change of velocities to a wanted change that the joints can make, within inequalities.

    Changes have the shape (n,) [rad/s], ``reach`` is the greatest of each joint, and bounds are below 0 where the
    present velocity exceeds its bound. Where the inequalities cannot all be met in one step, the joints come as near to
    that as they can: each inequality may be exceeded, at a cost (an exact penalty would need no less than the greatest
    multiplier).
    """
    rows, left = limit.rows, limit.bounds
    if (rows @ wanted <= left + ROUNDING).all():
        return wanted
    # Only what some change within reach could exceed.
    concerned = np.abs(rows) @ reach > left
    rows, left = rows[concerned], left[concerned]
    size, count = len(wanted), len(left)
    excess = np.maximum(-left, 0.0)
    # Unknown are the change, and by how much each inequality is exceeded more than it is now.
    change, further = np.eye(size, size + count), np.eye(count, size + count, size)
    limit = Limit(
        np.vstack((rows @ change - further, change, -change, -further)),
        np.concatenate((left + excess, reach, reach, excess)),
    )
    found, _ = solve([Task(change, wanted), Task(further, -excess, EXCESS_COST)], ROUNDING, limit)
    return np.asarray(found[:size])


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
