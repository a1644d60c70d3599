"""Trajectories to drive the arm with, made without a planner."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robot.trajectory import Trajectory


def smooth_move(moves: Mapping[str, tuple[float, float]], duration_s: float, rate_hz: float = 100.0) -> Trajectory:
    """From rest to rest along a straight joint line, by the quintic of least jerk."""
    time_s = np.linspace(0.0, duration_s, round(duration_s * rate_hz) + 1)
    u = time_s / duration_s
    s = 10 * u**3 - 15 * u**4 + 6 * u**5
    ds = (30 * u**2 - 60 * u**3 + 30 * u**4) / duration_s
    dds = (60 * u - 180 * u**2 + 120 * u**3) / duration_s**2
    start = np.array([move[0] for move in moves.values()])
    way = np.array([move[1] - move[0] for move in moves.values()])
    return Trajectory(tuple(moves), time_s, start + np.outer(s, way), np.outer(ds, way), np.outer(dds, way))
