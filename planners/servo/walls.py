"""What joints must not do now, as inequalities on their velocities: limits and things ahead.

The speed at which a wall is neared shrinks with the distance to it; along it and away from it all is free. See
Faverjon and Tournassoud, A local based approach for path planning of manipulators with a high number of degrees of
freedom, 1987.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.geometry.nearness import NearPair
from planners.servo.question import ServoLimits

Vector = NDArray[np.float64]

# Speed of approach per distance left. With it a joint at full speed brakes as hard as it can, and no harder.
APPROACH_PER_S = 2.5

# Things further away than this hold back no speed that is asked for: 0.3 m/s.
WATCHED_M = 0.12


@dataclass(frozen=True)
class Walls:
    """Inequalities ``rows @ velocity <= bounds``; at rest all of them hold.

    Attributes:
        rows: shape (k, n).
        bounds: shape (k,), none below 0.
        pairs: what the last of them are about; those before are limits of joints.
    """

    rows: Vector
    bounds: Vector
    pairs: Sequence[NearPair]

    def near(self, active: NDArray[np.intp]) -> list[NearPair]:
        """The pairs that some inequalities are about."""
        first = len(self.bounds) - len(self.pairs)
        return [self.pairs[index - first] for index in active if index >= first]

    def joints(self, active: NDArray[np.intp]) -> list[int]:
        """The joints whose limits some inequalities are about."""
        count = len(self.rows[0])
        return sorted({int(index) % count for index in active if index < len(self.bounds) - len(self.pairs)})


def walls(
    q: Vector, lower: Vector, upper: Vector, columns: NDArray[np.intp], pairs: Sequence[NearPair], limits: ServoLimits
) -> Walls:
    """The walls around a configuration.

    Args:
        q: positions of the joints that may move, shape (n,) [rad].
        lower: their limits, shape (n,) [rad].
        upper: likewise.
        columns: their places in the slopes of pairs.
        pairs: what is near.
        limits: what distances are to be kept.
    """
    kept = [limits.scene_distance_m if pair.by_object else limits.self_distance_m for pair in pairs]
    watched = [(pair, kept_m) for pair, kept_m in zip(pairs, kept, strict=True) if kept_m is not None]
    left_m = np.array([pair.distance_m - kept_m for pair, kept_m in watched])
    slopes = np.array([pair.slope_m_per_rad[columns] for pair, _ in watched]).reshape(-1, len(q))
    room = np.concatenate((upper - q, q - lower, left_m))
    rows = np.vstack((np.eye(len(q)), -np.eye(len(q)), -slopes))
    return Walls(rows, APPROACH_PER_S * np.maximum(room, 0.0), [pair for pair, _ in watched])
