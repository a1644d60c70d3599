"""Prisms: a polygon drawn out along z, as the triangles of its surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planners.scene import Mesh

Corner = tuple[float, float]


def prism(polygon: Sequence[Corner], height_m: float) -> Mesh | None:
    """The surface of a prism, its middle at z = 0; None for a polygon that crosses itself or has no area.

    Args:
        polygon: corners in their order, whichever way round [m]; the last is joined to the first.
        height_m: along z [m].
    """
    corners = polygon if _area(polygon) > 0.0 else polygon[::-1]
    lid = _ears(corners)
    if lid is None:
        return None
    count = len(corners)
    flat = np.array(corners)
    levels = [np.column_stack((flat, np.full(count, z_m))) for z_m in (-0.5 * height_m, 0.5 * height_m)]
    floor = [(a, c, b) for a, b, c in lid]
    roof = [(a + count, b + count, c + count) for a, b, c in lid]
    walls = []
    for i in range(count):
        j = (i + 1) % count
        walls += [(i, j, j + count), (i, j + count, i + count)]
    return Mesh(np.vstack(levels), np.array([*floor, *roof, *walls], dtype=np.int32))


def _ears(corners: Sequence[Corner]) -> list[tuple[int, int, int]] | None:
    """Triangles that cover a polygon which runs counter-clockwise, by cutting off one ear after the other."""
    left = list(range(len(corners)))
    triangles = []
    while len(left) >= 3:
        ear = next((i for i in range(len(left)) if _is_ear(corners, left, i)), None)
        if ear is None:
            return None
        triangles.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    return triangles or None


def _is_ear(corners: Sequence[Corner], left: Sequence[int], i: int) -> bool:
    around = (left[i - 1], left[i], left[(i + 1) % len(left)])
    a, b, c = (corners[k] for k in around)
    if _area((a, b, c)) <= 0.0:
        return False
    return not any(_inside(corners[k], a, b, c) for k in left if k not in around)


def _inside(point: Corner, a: Corner, b: Corner, c: Corner) -> bool:
    """Whether a point is in a triangle that runs counter-clockwise, or on its edge."""
    return all(_area((first, second, point)) >= 0.0 for first, second in ((a, b), (b, c), (c, a)))


def _area(corners: Sequence[Corner]) -> float:
    """Twice the area that corners enclose, below 0 where they run clockwise [m^2]."""
    following = [*corners[1:], *corners[:1]]
    return sum(x * v - u * y for (x, y), (u, v) in zip(corners, following, strict=True))
