"""Boxes around shapes that two joints carry, and which of them are near each other, many at once.

Boxes of the same joint lie along its axes. numpy is slow with a last axis of three, so the first axis is x, y, z.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from robot.trajectory import Vector

# Cross products with the unit vectors along x, y and z from the left, as matrices.
_ACROSS = np.zeros((3, 3, 3))
for _x, _y, _z in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _ACROSS[_x, _y, _z], _ACROSS[_x, _z, _y] = -1.0, 1.0


@dataclass(frozen=True)
class Boxes:
    """Boxes along the axes of one joint."""

    middles_m: Vector  # shape (3, n), in the joint's frame [m]
    halves_m: Vector  # shape (3, n), half the edges [m]

    @classmethod
    def between(cls, lower_m: Vector, upper_m: Vector) -> Boxes:
        """Return the boxes between corners, shape (n, 3) each [m]."""
        return cls(np.ascontiguousarray(0.5 * (lower_m + upper_m).T), np.ascontiguousarray(0.5 * (upper_m - lower_m).T))

    @cached_property
    def around(self) -> Boxes:
        """One box around all of them."""
        lower_m, upper_m = (self.middles_m - self.halves_m).min(axis=1), (self.middles_m + self.halves_m).max(axis=1)
        return Boxes.between(lower_m[np.newaxis], upper_m[np.newaxis])

    def chosen(self, indices: NDArray[np.intp]) -> Boxes:
        """Return some of them."""
        return Boxes(self.middles_m[:, indices], self.halves_m[:, indices])


def overlap_m(first: Boxes, second: Boxes, between: pin.SE3) -> Vector:
    """Return how far boxes of two joints overlap along the axis of least overlap, shape (first, second) [m].

    Shapes in the boxes cannot overlap deeper; below 0 they are at least that far apart. ``between`` is the pose of the
    second joint in the first one's frame.
    """
    # Along the axes of one joint the boxes of the other are wider than they are: by the whole link, for a table.
    by_first_m = _along_axes_m(first, second, between).min(axis=0)
    by_second_m = _along_axes_m(second, first, between.inverse()).min(axis=0)
    least_m: Vector = np.minimum(by_first_m, by_second_m.T)
    return least_m


def least_distance_m(first: Boxes, second: Boxes, between: pin.SE3) -> Vector:
    """Return lower bounds of the distances of shapes in the boxes, of their overlap if negative.

    Arguments and shape as for :func:`overlap_m`.
    """
    by_first_m = _along_axes_m(first, second, between)
    by_second_m = _along_axes_m(second, first, between.inverse()).swapaxes(1, 2)
    overlaps_m = np.minimum(by_first_m.min(axis=0), by_second_m.min(axis=0))
    apart_m2 = ((np.minimum(each_m, 0.0) ** 2).sum(axis=0) for each_m in (by_first_m, by_second_m))
    bounds_m: Vector = np.where(overlaps_m > 0.0, -overlaps_m, np.sqrt(np.maximum(*apart_m2)))
    return bounds_m


def near_pairs(first: Boxes, second: Boxes, between: pin.SE3, margin_m: float) -> NDArray[np.intp]:
    """Return the pairs of boxes that no plane separates by more than a margin, shape (pairs, 2), most overlap first.

    The planes are across the axes of both joints and the products of two axes: Gottschalk et al., "OBBTree", 1996.
    Arguments as for :func:`overlap_m`.
    """
    # Of two links' thousand boxes a few come near the one around all of the other's.
    i = np.flatnonzero(_along_axes_m(second.around, first, between.inverse()).min(axis=0)[0] >= -margin_m)
    j = np.flatnonzero(_along_axes_m(first.around, second, between).min(axis=0)[0] >= -margin_m) if len(i) else i
    if not len(j):
        return np.empty((0, 2), dtype=np.intp)
    overlaps_m = overlap_m(first.chosen(i), second.chosen(j), between).ravel()
    near = np.flatnonzero(overlaps_m >= -margin_m)
    near = near[np.argsort(-overlaps_m[near], kind="stable")]
    i, j = i[near // len(j)], j[near % len(j)]
    pairs: NDArray[np.intp] = np.stack((i, j), axis=1)
    return pairs[_meet_across_edges(first.chosen(i), second.chosen(j), between, margin_m)]


def _along_axes_m(first: Boxes, second: Boxes, between: pin.SE3) -> Vector:
    """Return how far boxes overlap along each axis of the first one's joint, shape (3, first, second) [m]."""
    middles_m = between.rotation @ second.middles_m + between.translation[:, np.newaxis]
    halves_m = np.abs(between.rotation) @ second.halves_m
    offset_m = first.middles_m[:, :, np.newaxis] - middles_m[:, np.newaxis]
    overlaps_m: Vector = first.halves_m[:, :, np.newaxis] + halves_m[:, np.newaxis] - np.abs(offset_m)
    return overlaps_m


def _meet_across_edges(first: Boxes, second: Boxes, between: pin.SE3, margin_m: float) -> NDArray[np.bool_]:
    """Return the pairs (i-th with i-th box) that no plane along an edge of both separates by more than a margin."""
    rotation = between.rotation
    axes = (_ACROSS @ rotation).swapaxes(1, 2).reshape(9, 3)
    offset_m = rotation @ second.middles_m + between.translation[:, np.newaxis] - first.middles_m
    reach_m = np.abs(axes) @ first.halves_m + np.abs(axes @ rotation) @ second.halves_m
    reach_m += margin_m * np.sqrt((axes**2).sum(axis=1))[:, np.newaxis]
    return np.asarray((np.abs(axes @ offset_m) <= reach_m).all(axis=0))
