"""Convex parts of a mesh: its hull where that is close enough, else the hulls of what planes across the axes leave.

The part that stands out of the mesh furthest is cut next, where that saves most volume, until no part stands out by
more than the tolerance; then parts that have a common hull within the tolerance are joined. Triangles are clipped at
the planes and hulls only ever grow afterwards, so the parts always cover the surface. CoACD (Wei et al. 2022), whose
measure is a concavity that also counts volume, gave 41 parts that stand out by 4.0 mm for the SO-101's lower arm in
120 s; this gave 15 within 2.5 mm in 20 s, and for a UR5's forearm 10 within 2.7 mm instead of 29 within 7.9 mm.
"""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from planners.assistant.surface import ConvexPart, Deviation, Surface, components, measure, sample, sample_with_normals
from planners.geometry.shapes import evenly_spread
from planners.geometry.surfaces import INSIDE
from robot.trajectory import Vector

TOLERANCE_M = 0.003  # deviation that parts may have from their mesh [m]

# Parts are cut to this share of the tolerance, the rest is for points between the samples; to the next one where the
# finer measurement afterwards finds more.
RESERVES = (0.85, 0.65, 0.45)

MAX_PARTS = 128  # parts that one mesh gets at most
MAX_TIME_S = 120.0  # CPU time for one mesh [s]
MAX_TRIANGLES = 500_000  # triangles of a mesh: time and memory grow with them

# Corners of a part; one with more is enclosed by planes across as few of these numbers of directions as will do.
MAX_CORNERS = 48
DIRECTIONS = (42, 80, 126)

# Points of the surface that distances are measured to, and points that tell inside from outside.
REFERENCE_POINTS = 60_000
DIPOLES = 3_000

# Points on a part at which it is measured, and at which cuts are compared.
PART_POINTS = 600
CUT_POINTS = 500

WINDING_CHUNK = 64  # points whose winding number is computed at a time, the farthest first

# Places of the cuts that are compared along each axis, as shares of the part's length.
CUTS = (0.2, 0.35, 0.5, 0.65, 0.8)

JOIN_TRIES = 3  # tries to join two parts, a part: of the pairs that would grow least
MIN_SLICE_M = 0.001  # a thinner slice is not cut off [m]


@dataclass(frozen=True)
class Limits:
    """Bounds of a decomposition."""

    tolerance_m: float = TOLERANCE_M  # deviation to reach [m]
    max_parts: int = MAX_PARTS  # parts of a mesh
    max_time_s: float = MAX_TIME_S  # CPU time for a mesh [s]
    seed: int = 0  # of the samples
    # CPU time [s]: a busy machine makes the same parts, later.
    clock: Callable[[], float] = field(default=time.process_time)


@dataclass(frozen=True)
class Decomposition:
    """Convex parts of a mesh, and their deviation from it."""

    parts: tuple[ConvexPart, ...]
    deviation: Deviation


class Reference:
    """Surface of the whole mesh, with which parts are compared at points that ``random`` draws."""

    def __init__(self, surface: Surface, random: np.random.Generator) -> None:
        self._random = random
        self._tree = cKDTree(sample(surface, REFERENCE_POINTS, random))
        places, normals = sample_with_normals(surface, DIPOLES, random)
        # Half the digits are enough to tell inside from outside, and take half the time.
        self._middle = places.mean(axis=0)
        self._places = (places - self._middle).astype(np.float32)
        self._normals = (normals * (surface.area_m2 / DIPOLES)).astype(np.float32)
        self._squares = (self._places**2).sum(axis=1)
        self._heights = (self._places * self._normals).sum(axis=1)

    def stands_out_m(self, part: ConvexPart, beyond_m: float, count: int = PART_POINTS) -> float:
        """Return how far a part stands out of the surface [m]; 0 where that is not beyond a distance [m]."""
        points_m = np.vstack((part.vertices_m, sample(part.surface, count, self._random)))
        distances_m, _ = self._tree.query(points_m)
        order = np.argsort(-distances_m)
        order = order[distances_m[order] > beyond_m]
        for start in range(0, len(order), WINDING_CHUNK):
            chunk = order[start : start + WINDING_CHUNK]
            outside = chunk[self._winding(points_m[chunk]) < INSIDE]
            if len(outside):
                return float(distances_m[outside[0]])
        return 0.0

    def _winding(self, points_m: Vector) -> Vector:
        """Return the winding number of points off the surface, by dipoles (Barill et al. 2018, eq. 7)."""
        points = (points_m - self._middle).astype(np.float32)
        squares = (points**2).sum(axis=1)[:, np.newaxis] + self._squares - 2.0 * points @ self._places.T
        heights = self._heights - points @ self._normals.T
        squares = np.maximum(squares, 1e-9)
        return np.asarray(np.abs((heights / (squares * np.sqrt(squares))).sum(axis=1)) / (4.0 * np.pi))


def decompose(surface: Surface, limits: Limits) -> Decomposition:
    """Find convex parts that cover a surface of :data:`MAX_TRIANGLES` at most, the closest within the limits."""
    search = _Search(surface, limits)
    found: list[Decomposition] = []
    for reserve in RESERVES:
        parts = search.parts(reserve * limits.tolerance_m)
        found.append(Decomposition(tuple(parts), measure(surface, parts, np.random.default_rng(limits.seed))))
        if found[-1].deviation.greatest_m <= limits.tolerance_m or search.time_is_up():
            break
    return min(found, key=lambda each: each.deviation.greatest_m)


class _Search:
    """Search for the parts of one surface."""

    def __init__(self, surface: Surface, limits: Limits) -> None:
        self._limits = limits
        self._until_s = limits.clock() + limits.max_time_s
        self._reference = Reference(surface, np.random.default_rng(limits.seed))
        self._whole = ConvexPart(surface.vertices_m)
        pieces = components(surface)
        hulls = _without_contained([ConvexPart(piece.vertices_m) for piece in pieces])
        separate = [piece.corners_m for piece in pieces if not _inside_one(piece, hulls)]
        self._pieces = separate if len(hulls) < limits.max_parts else [surface.corners_m]

    def time_is_up(self) -> bool:
        return self._limits.clock() >= self._until_s

    def parts(self, target_m: float) -> list[ConvexPart]:
        """Return parts that stand out by no more than a target where the limits allow it."""
        parts = [self._whole]
        if self._reference.stands_out_m(self._whole, target_m, 4 * PART_POINTS) > 0.0:
            # Corners are the cost of joining parts, so they go first.
            cut = _without_contained(self._cut(target_m))
            parts = self._joined([self._simpler(part, target_m) for part in cut], target_m)
        return [self._simpler(part, target_m) for part in _without_contained(parts)]

    def _cut(self, target_m: float) -> list[ConvexPart]:
        done: list[ConvexPart] = []
        waiting: list[tuple[float, int, Vector, ConvexPart]] = []
        order = itertools.count()  # parts that stand out as far as each other cannot be compared

        def add(corners_m: Vector) -> None:
            part = ConvexPart(corners_m.reshape(-1, 3))
            out_m = self._reference.stands_out_m(part, target_m)
            if out_m <= target_m:
                done.append(part)
            else:
                heapq.heappush(waiting, (-out_m, next(order), corners_m, part))

        for piece in self._pieces:
            add(piece)
        for cut in itertools.count():
            if not waiting or len(done) + len(waiting) >= self._limits.max_parts or self.time_is_up():
                break
            _, _, corners_m, part = heapq.heappop(waiting)
            place = _best_cut(corners_m, part, np.random.default_rng((self._limits.seed, cut)))
            if place is None:
                done.append(part)
                continue
            for side in clipped(corners_m, *place):
                add(side)
        return done + [part for _, _, _, part in waiting]

    def _joined(self, parts: Sequence[ConvexPart], target_m: float) -> list[ConvexPart]:
        """Make one part of each two that have a common hull within the target; those that grow least first."""
        alive = dict(enumerate(parts))
        volumes = {index: _volume(part.vertices_m) for index, part in alive.items()}
        grown = ((_growth(alive, volumes, i, j), i, j) for i in alive for j in alive if i < j)
        waiting = [(growth, i, j) for growth, i, j in grown if growth is not None]
        heapq.heapify(waiting)
        tries = JOIN_TRIES * len(parts)
        while waiting and tries and not self.time_is_up():
            _, i, j = heapq.heappop(waiting)
            if i not in alive or j not in alive:
                continue
            tries -= 1
            union = ConvexPart(np.vstack((alive[i].vertices_m, alive[j].vertices_m)))
            if self._reference.stands_out_m(union, target_m) > 0.0:
                continue
            del alive[i], alive[j]
            index = len(volumes)
            volumes[index], alive[index] = _volume(union.vertices_m), union
            for other in list(alive)[:-1]:
                if (growth := _growth(alive, volumes, other, index)) is not None:
                    heapq.heappush(waiting, (growth, other, index))
        return list(alive.values())

    def _simpler(self, part: ConvexPart, target_m: float) -> ConvexPart:
        """Return a part that encloses a part with fewer corners where it stands out no further than the target."""
        if len(part.vertices_m) <= MAX_CORNERS:
            return part
        allowed_m = max(target_m, self._reference.stands_out_m(part, target_m))
        for count in DIRECTIONS:
            wider = part.within(evenly_spread(count))
            if self._reference.stands_out_m(wider, allowed_m) == 0.0:
                return wider
        return part


def _best_cut(corners_m: Vector, part: ConvexPart, random: np.random.Generator) -> tuple[int, float] | None:
    """Return axis and place of the cut whose two hulls have the least volume; None for a part too small to cut."""
    vertices = corners_m.reshape(-1, 3)
    soup = Surface(vertices, np.arange(len(vertices)).reshape(-1, 3))
    hull_points = random.choice(part.vertices_m, min(CUT_POINTS // 4, len(part.vertices_m)), replace=False)
    points = np.vstack((hull_points, sample(soup, CUT_POINTS, random)))
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    best: tuple[float, int, float] | None = None
    for axis in range(3):
        if upper[axis] - lower[axis] < 2.0 * MIN_SLICE_M:
            continue
        for share in CUTS:
            place = float(lower[axis] + share * (upper[axis] - lower[axis]))
            below = points[:, axis] <= place
            volume = _volume(points[below]) + _volume(points[~below])
            if best is None or volume < best[0]:
                best = volume, axis, place
    return None if best is None else best[1:]


def clipped(corners_m: Vector, axis: int, place_m: float) -> list[Vector]:
    """Cut triangles at a plane across an axis; return the corners of those below and above, shape (m, 3, 3) each."""
    above = corners_m[:, :, axis] > place_m
    count = above.sum(axis=1)
    sides: list[list[Vector]] = [[corners_m[count == 0]], [corners_m[count == 3]]]
    for upper in (False, True):
        lone = count == (1 if upper else 2)
        crossing, alone = corners_m[lone], (above[lone] == upper).argmax(axis=1)
        rows = np.arange(len(crossing))
        a, b, c = (crossing[rows, (alone + k) % 3] for k in range(3))
        ab, ac = (_crossed(a, other, axis, place_m) for other in (b, c))
        sides[upper].append(np.stack((a, ab, ac), axis=1))
        sides[not upper] += [np.stack((ab, b, c), axis=1), np.stack((ab, c, ac), axis=1)]
    return [found for found in (np.concatenate(side) for side in sides) if len(found)]


def _crossed(a: Vector, b: Vector, axis: int, place_m: float) -> Vector:
    share = (place_m - a[:, axis]) / (b[:, axis] - a[:, axis])
    points: Vector = a + share[:, np.newaxis] * (b - a)
    points[:, axis] = place_m
    return points


def _volume(points_m: Vector) -> float:
    try:
        return float(ConvexHull(points_m).volume)
    except (QhullError, ValueError):
        return 0.0


def _growth(alive: dict[int, ConvexPart], volumes: dict[int, float], i: int, j: int) -> float | None:
    """Return the volume that the hull of two parts has beyond theirs [m3]; None for parts that are apart."""
    first, second = alive[i].vertices_m, alive[j].vertices_m
    gap = np.maximum(first.min(axis=0) - second.max(axis=0), second.min(axis=0) - first.max(axis=0))
    if gap.max() > MIN_SLICE_M:
        return None
    return _volume(np.vstack((first, second))) - volumes[i] - volumes[j]


def _inside_one(piece: Surface, hulls: Sequence[ConvexPart]) -> bool:
    """Tell whether a piece is wholly inside a hull that is not its own: of a screw in a hole."""
    own = np.ptp(piece.vertices_m, axis=0)
    return any(
        np.any(np.ptp(hull.vertices_m, axis=0) > own) and hull.depth_m(piece.vertices_m).max() < 0.0 for hull in hulls
    )


def _without_contained(parts: Sequence[ConvexPart]) -> list[ConvexPart]:
    kept: list[ConvexPart] = []
    for part in sorted(parts, key=lambda each: -float(np.prod(np.ptp(each.vertices_m, axis=0)))):
        if not any(other.depth_m(part.vertices_m).max() <= 0.0 for other in kept):
            kept.append(part)
    return kept
