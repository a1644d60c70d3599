"""A polyline with rounded corners, as a path over its length that TOPP-RA can time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from toppra.interpolator import AbstractGeometricPath

Vector = NDArray[np.float64]

# Pieces shorter than this are rounding errors of the construction.
SHORTEST_RAD = 1e-9


@dataclass(frozen=True)
class _Piece:
    """A stretch of the path whose unit tangent turns smoothly from ``tangent`` by ``turn``; 0 on a line."""

    start_s: float
    length: float
    origin: Vector
    tangent: Vector
    turn: Vector

    def at(self, s: Vector, order: int) -> Vector:
        """Position, tangent or curvature at path lengths ``s``, shape (k, n).

        The tangent turns by h(u) = 3u^2 - 2u^3 of ``turn``, u from 0 to 1, so that the curvature starts and ends
        at zero: TOPP-RA needs it continuous to keep acceleration limits between its grid points.
        """
        u = ((s - self.start_s) / self.length)[:, np.newaxis]
        if order == 0:
            return self.origin + self.length * (self.tangent * u + self.turn * (u**3 - 0.5 * u**4))
        if order == 1:
            return self.tangent + self.turn * (3.0 * u**2 - 2.0 * u**3)
        return self.turn * (6.0 * u - 6.0 * u**2) / self.length


class BlendedPath(AbstractGeometricPath):
    """A polyline whose corners are rounded within ``blend_rad`` of each, twice differentiable in its length.

    A corner is cut by at most 3/8 of ``blend_rad``. With ``blend_rad`` 0 the path is the polyline itself.

    Args:
        points: shape (m, n), m >= 2, no two successive ones equal [rad].
        blend_rad: distance from a corner at which the path leaves the line, at most half of either line.

    Attributes:
        knots: lengths at which lines and blends meet, from 0 to the whole length [rad].
        in_blend: for each stretch between knots, whether it is a blend.
    """

    def __init__(self, points: Vector, blend_rad: float) -> None:
        self._pieces = _pieces(points, blend_rad)
        self.knots = np.array([piece.start_s for piece in self._pieces] + [self._end()])
        self.in_blend = tuple(bool(np.any(piece.turn)) for piece in self._pieces)

    def __call__(self, path_positions: float | Vector, order: int = 0) -> Vector:
        """Position [rad], tangent or curvature [1/rad] at lengths; shape (n,) for a number, (k, n) for an array."""
        s = np.atleast_1d(np.asarray(path_positions, dtype=np.float64))
        which = np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, len(self._pieces) - 1)
        values = np.empty((len(s), self.dof))
        for index in np.unique(which):
            values[which == index] = self._pieces[index].at(s[which == index], order)
        return values[0] if np.isscalar(path_positions) else values

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self._pieces[0].origin)

    @property
    def path_interval(self) -> Vector:
        """First and last length."""
        return self.knots[[0, -1]]

    def _end(self) -> float:
        return self._pieces[-1].start_s + self._pieces[-1].length


def _pieces(points: Vector, blend_rad: float) -> list[_Piece]:
    edges = np.diff(points, axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    tangents = edges / lengths[:, np.newaxis]
    # A corner takes at most half of the lines that meet there; the two ends of the path take nothing.
    cuts = np.minimum(blend_rad, 0.5 * np.minimum(lengths[:-1], lengths[1:]))
    cuts = np.concatenate(([0.0], cuts, [0.0]))
    pieces: list[_Piece] = []
    s = 0.0
    for i, tangent in enumerate(tangents):
        line = float(lengths[i] - cuts[i] - cuts[i + 1])
        candidates = [(line, points[i] + cuts[i] * tangent, np.zeros_like(tangent))]
        if i + 1 < len(tangents):
            blend = 2.0 * float(cuts[i + 1])
            candidates.append((blend, points[i + 1] - cuts[i + 1] * tangent, tangents[i + 1] - tangent))
        for length, origin, turn in candidates:
            if length > SHORTEST_RAD:
                pieces.append(_Piece(s, length, origin, tangent, turn))
                s += length
    return pieces
