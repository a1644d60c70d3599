"""Meshes of simple bodies."""

import numpy as np
from numpy.typing import NDArray


def ball(radius_m: float, around: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return vertices and triangles of a ball about the origin [m], with so many circles in each direction."""
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, around), np.linspace(0.0, np.pi, around), indexing="ij")
    vertices = radius_m * np.stack((np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)), axis=-1).reshape(-1, 3)
    corner = (np.arange(around - 1)[:, np.newaxis] * around + np.arange(around - 1)).ravel()
    halves = (corner, corner + 1, corner + around), (corner + 1, corner + around, corner + around + 1)
    return vertices, np.vstack([np.stack(half, axis=1) for half in halves]).astype(np.int32)
