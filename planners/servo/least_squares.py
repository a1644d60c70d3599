"""Small least-squares problems with inequalities, solved by the primal active-set method.

See Nocedal and Wright, Numerical Optimization, 2nd edition, algorithm 16.3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

# Each step adds or drops one inequality; ten suffice for what an arm meets. What has been found until then is within
# all of them.
MAX_STEPS = 40

# Shorter steps and smaller multipliers are rounding.
NOTHING = 1e-9


def bounded_least_squares(
    matrix: Vector, wanted: Vector, damping: float, rows: Vector, bounds: Vector
) -> tuple[Vector, NDArray[np.intp]]:
    """The x of least ``|matrix x - wanted|^2 + damping^2 |x|^2`` for which ``rows x <= bounds``.

    Args:
        matrix: shape (m, n).
        wanted: shape (m,).
        damping: above 0.
        rows: shape (k, n).
        bounds: shape (k,), none below 0: x = 0 is always allowed.

    Returns:
        x, shape (n,), and which inequalities hold it back.
    """
    size = matrix.shape[1]
    hessian = matrix.T @ matrix + damping**2 * np.eye(size)
    x = np.zeros(size)
    active: list[int] = []
    for _ in range(MAX_STEPS):
        step, multipliers = _step_along(hessian, matrix.T @ wanted - hessian @ x, rows[active])
        if len(active) == size or np.abs(step).max() <= NOTHING:
            if not active or multipliers.min() >= -NOTHING:
                break
            del active[int(np.argmin(multipliers))]
            continue
        share, blocking = _room(x, step, rows, bounds, active)
        x = x + share * step
        if blocking is not None:
            active.append(blocking)
    return x, np.array(active, dtype=np.intp)


def _step_along(hessian: Vector, slope: Vector, rows: Vector) -> tuple[Vector, Vector]:
    """The best step that keeps to the active inequalities, and what pushes against each."""
    size, held = len(slope), len(rows)
    system = np.zeros((size + held, size + held))
    system[:size, :size] = hessian
    system[:size, size:] = rows.T
    system[size:, :size] = rows
    solution = np.linalg.solve(system, np.concatenate((slope, np.zeros(held))))
    return np.asarray(solution[:size]), np.asarray(solution[size:])


def _room(x: Vector, step: Vector, rows: Vector, bounds: Vector, active: list[int]) -> tuple[float, int | None]:
    """How much of a step is allowed, and the first inequality that blocks the rest."""
    gain = rows @ step
    gain[active] = 0.0
    towards = np.flatnonzero(gain > NOTHING * max(1.0, float(np.abs(step).max())))
    if not towards.size:
        return 1.0, None
    shares = np.maximum(bounds[towards] - rows[towards] @ x, 0.0) / gain[towards]
    first = int(np.argmin(shares))
    return (1.0, None) if shares[first] >= 1.0 else (float(shares[first]), int(towards[first]))
