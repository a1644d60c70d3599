"""Differential inverse kinematics: from desired velocities to joint velocities, or from errors to a step of the joints.

The words are pink's: a task is a desired motion, a limit bounds how fast joints move, and a barrier how fast a distance
shrinks. Tasks of lower priority use the directions that tasks of higher priority leave free (Siciliano & Slotine, "A
general framework for managing multiple tasks in highly redundant robotic systems", 1991).

The least-squares problems with inequalities are solved by the primal active-set method: Nocedal and Wright, Numerical
Optimization, 2nd edition, algorithm 16.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robot.trajectory import Vector

# Each step adds or drops one inequality; ten suffice for what an arm meets. Every step keeps all inequalities, so a
# solution that is not optimal yet is of use.
MAX_STEPS = 40

ROUNDING = 1e-9  # shorter steps and smaller multipliers are rounding

NONE_ACTIVE = np.array([], dtype=np.intp)


@dataclass(frozen=True)
class Task:
    """A velocity that is linear in the velocities of the joints, and its desired value."""

    jacobian: Vector  # shape (m, n)
    velocity: Vector  # the desired value, shape (m,)
    cost: float = 1.0  # weight of its error among the tasks of the same priority


@dataclass(frozen=True)
class Limit:
    """Inequalities ``rows @ velocity <= bounds``, rows of shape (k, n), bounds of shape (k,) and none below 0."""

    rows: Vector
    bounds: Vector

    def also(self, other: Limit) -> Limit:
        """Return both limits, this one first."""
        return Limit(np.vstack((self.rows, other.rows)), np.concatenate((self.bounds, other.bounds)))


def velocity_limit(max_velocity: Vector) -> Limit:
    """Return the limit of velocities to both sides, shape (n,)."""
    both_ways = np.vstack((np.eye(len(max_velocity)), -np.eye(len(max_velocity))))
    return Limit(both_ways, np.concatenate((max_velocity, max_velocity)))


def barrier(distances: Vector, gradients: Vector, max_change: Vector, period: float, gain: float) -> Limit:
    """Return the speeds at which distances may shrink, so that the joints brake before any falls below 0.

    Faverjon and Tournassoud, "A local based approach for path planning of manipulators with a high number of degrees of
    freedom", 1987, with the distance in which the joints come to rest.

    Distances have the shape (k,), and below 0 they may grow only; gradients by the joints (k, n). Braking may count on
    ``max_change`` of each joint's velocity in a ``period``, shape (n,), after which a velocity has its effect [s].
    ``gain`` is the greatest speed by distance [1/s].
    """
    room = np.maximum(distances, 0.0)
    # With v' = v - change the way to rest is v * period + v^2 / (2 a): solved for v.
    braking = np.abs(gradients) @ max_change / period
    lost = braking * period
    brakes_within = np.sqrt(lost**2 + 2.0 * braking * room) - lost
    return Limit(-gradients, np.minimum(gain * room, brakes_within))


def free_directions(jacobian: Vector, damping: float) -> Vector:
    """Return the projection, (n, n), onto velocities that change a task of Jacobian (m, n) by less than the damping."""
    square = jacobian @ jacobian.T
    square.flat[:: len(square) + 1] += damping**2
    return np.asarray(np.eye(jacobian.shape[1]) - jacobian.T @ np.linalg.solve(square, jacobian))


def solve(
    tasks: Sequence[Task],
    damping: float,
    limit: Limit | None = None,
    before: Vector | None = None,
    free: Vector | None = None,
) -> tuple[Vector, NDArray[np.intp]]:
    """Return the velocities of the joints that meet tasks of one priority best, and the indices of active limits.

    ``damping`` is the weight of the velocities themselves, or of their change, above 0. Tasks of higher priority need
    the velocities ``before``, which keep the limit and may be changed in the directions ``free``, in columns, shape (n,
    f); None for all.
    """
    matrix, desired = tasks[0].cost * tasks[0].jacobian, tasks[0].cost * tasks[0].velocity
    for task in tasks[1:]:
        matrix = np.vstack((matrix, task.cost * task.jacobian))
        desired = np.concatenate((desired, task.cost * task.velocity))
    if before is not None:
        desired = desired - matrix @ before
    inside = matrix if free is None else matrix @ free
    if limit is None:
        change, active = damped_least_squares(inside, desired, damping), NONE_ACTIVE
    else:
        rows = limit.rows if free is None else limit.rows @ free
        bounds = np.maximum(limit.bounds if before is None else limit.bounds - limit.rows @ before, 0.0)
        change, active = bounded_least_squares(inside, desired, damping, rows, bounds)
    change = change if free is None else free @ change
    return (change if before is None else before + change), active


def damped_least_squares(matrix: Vector, desired: Vector, damping: float) -> Vector:
    """Return the x of least ``|matrix x - desired|^2 + damping^2 |x|^2``, shape (n,)."""
    hessian = matrix.T @ matrix
    hessian.flat[:: len(hessian) + 1] += damping**2
    return np.asarray(np.linalg.solve(hessian, matrix.T @ desired))


def bounded_least_squares(
    matrix: Vector, desired: Vector, damping: float, rows: Vector, bounds: Vector
) -> tuple[Vector, NDArray[np.intp]]:
    """Minimize ``|matrix x - desired|^2 + damping^2 |x|^2`` for ``rows x <= bounds >= 0``; return x and active rows."""
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
        elif not active:
            break
    return x, np.array(active, dtype=np.intp)


def _step_along(hessian: Vector, slope: Vector, rows: Vector) -> tuple[Vector, Vector]:
    """Return the best step that keeps to the active inequalities, and the multiplier of each."""
    size, held = len(slope), len(rows)
    if not held:
        return np.asarray(np.linalg.solve(hessian, slope)), np.zeros(0)
    system = np.zeros((size + held, size + held))
    system[:size, :size] = hessian
    system[:size, size:] = rows.T
    system[size:, :size] = rows
    solution = np.linalg.solve(system, np.concatenate((slope, np.zeros(held))))
    return np.asarray(solution[:size]), np.asarray(solution[size:])


def _allowed_share(
    x: Vector, step: Vector, rows: Vector, bounds: Vector, active: list[int]
) -> tuple[float, int | None]:
    gain = rows @ step
    gain[active] = 0.0
    towards = np.flatnonzero(gain > ROUNDING * max(1.0, float(np.abs(step).max())))
    if not towards.size:
        return 1.0, None
    shares = np.maximum(bounds[towards] - rows[towards] @ x, 0.0) / gain[towards]
    first = int(np.argmin(shares))
    return (1.0, None) if shares[first] >= 1.0 else (float(shares[first]), int(towards[first]))
