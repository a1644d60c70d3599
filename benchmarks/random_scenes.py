"""Scenes drawn at random for the SO-101, and problems in them that have a solution.

A slow search in the official meshes has found a path for each problem: the planners under test have no influence on
the problems. Needs the reference data beside the checkout.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.full_meshes import Judge
from harness.server import REFERENCE

Vector = NDArray[np.float64]
Fields = dict[str, Any]
Corner = tuple[float, float, float]

JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
LIMITS = {
    "velocity": [3.0] * 5,
    "acceleration": [10.0] * 5,
    "lower": [-1.91986, -1.74533, -1.69, -1.65806, -2.74385],
    "upper": [1.91986, 1.74533, 1.69, 1.65806, 2.84121],
}
GRIPPER_RAD = 0.3
TOLERANCE_M = 0.005

LOWEST_TIP_M = 0.02  # above the table by more than the size of the gripper's fingers

# Edges of the slow search are checked this finely: 2 mm at the tip for the base joint.
CHECK_RAD = 0.005
EXTEND_RAD = 0.3
MAX_NODES = 3000


class RandomScene:
    """Things around the arm, and random problems among them."""

    def __init__(self, seed: int, number: int) -> None:
        objects, self._region = _objects(np.random.default_rng((seed, number)))
        self._rng = np.random.default_rng(seed)
        self._lower, self._upper = np.array(LIMITS["lower"]), np.array(LIMITS["upper"])
        self.fields: Fields = {
            "format": "so101-plan-bench/1",
            "name": f"random{seed}-{number}",
            "description": "random things",
            "frame": "base_link",
            "joint_names": JOINTS,
            "gripper": GRIPPER_RAD,
            "limits": LIMITS,
            "objects": objects,
            "attached": [],
            "joint_problems": [],
            "position_problems": [],
            "infeasible": [],
        }
        self.judge = Judge(REFERENCE, self.fields)

    def connected_pairs(self) -> Iterator[tuple[Vector, Vector]]:
        """Yield free starts and goals between which the slow search has found a path, without an end."""
        while True:
            start, goal = self._free(self._anywhere), self._free(self._in_region)
            if self._rng.random() < 0.5:
                start, goal = goal, start
            if _connected(self.judge.collides, start, goal, self._lower, self._upper, self._rng):
                yield start, goal

    def _free(self, draw: Callable[[], Vector]) -> Vector:
        while True:
            point = draw()
            if not self.judge.collides(point):
                return point

    def _anywhere(self) -> Vector:
        while True:
            point = self._rng.uniform(self._lower, self._upper)
            if self.judge.tip_m(point)[2] > LOWEST_TIP_M:
                return np.round(point, 6)

    def _in_region(self) -> Vector:
        lower, upper = self._region
        while True:
            point = self._anywhere()
            if np.all(self.judge.tip_m(point) > lower) and np.all(self.judge.tip_m(point) < upper):
                return point


def _objects(rng: np.random.Generator) -> tuple[list[Fields], tuple[Corner, Corner]]:
    """Draw things, and the region around one of them in which the tip of every second pose lies [m]."""
    things: list[Fields] = [TABLE] if rng.random() < 0.7 else []
    kinds = ("box", "cylinder", "sphere", "cone")
    for i in range(int(rng.integers(3, 16))):
        radius_m, angle, height_m = rng.uniform(0.16, 0.38), rng.uniform(-1.9, 1.9), rng.uniform(0.03, 0.25)
        width_m = rng.uniform(0.02, 0.07)
        kind = kinds[int(rng.integers(len(kinds)))]
        size = {
            "box": [width_m, rng.uniform(0.02, 0.1), height_m],
            "cylinder": [height_m, width_m / 2],
            "sphere": [width_m / 2],
            "cone": [height_m, width_m / 2],
        }[kind]
        middle = (radius_m * math.cos(angle), radius_m * math.sin(angle), rng.uniform(0.02, 0.3))
        things.append(_thing(f"{kind}{i}", kind, size, middle))
    if rng.random() < 0.3:
        things.append(_box("roof", (0.05, -0.2, 0.4), (0.3, 0.2, 0.42)))
    x, y, z = things[-1]["pose"]["position"]
    around = (x - 0.1, y - 0.1, max(0.02, z - 0.1)), (x + 0.1, y + 0.1, z + 0.12)
    return things, around


def _thing(name: str, kind: str, size: Sequence[float], middle: Sequence[float]) -> Fields:
    """Return a shape with its size as problem files have it, upright, at its middle."""
    return {"id": name, "type": kind, "dimensions": [round(float(s), 6) for s in size], "pose": _pose(middle)}


def _pose(middle: Sequence[float]) -> Fields:
    return {"position": [round(float(value), 6) for value in middle], "orientation": [0.0, 0.0, 0.0, 1.0]}


def _box(name: str, lower: Corner, upper: Corner) -> Fields:
    """Return a box between two corners."""
    size = [round(b - a, 6) for a, b in zip(lower, upper, strict=True)]
    return _thing(name, "box", size, tuple((a + b) / 2 for a, b in zip(lower, upper, strict=True)))


# As the table of a bench with the arm screwed on: just below its base.
TABLE = _box("table", (-0.3, -0.6, -0.053), (0.7, 0.6, -0.003))


def _connected(
    collides: Callable[[Vector], bool], start: Vector, goal: Vector, lower: Vector, upper: Vector, rng: Any
) -> bool:
    """Search with two trees that grow towards each other; returns True if they meet."""
    trees = [[start], [goal]]
    while len(trees[0]) + len(trees[1]) < MAX_NODES:
        reached = _grow(collides, trees[0], rng.uniform(lower, upper), EXTEND_RAD)
        if reached is not None:
            while True:
                met = _grow(collides, trees[1], reached, EXTEND_RAD)
                if met is None:
                    break
                if np.array_equal(met, reached):
                    return True
        trees.reverse()
    return False


def _grow(collides: Callable[[Vector], bool], tree: list[Vector], aim: Vector, reach_rad: float) -> Vector | None:
    """Add the end of a free step from the nearest node towards an aim."""
    nearest = tree[int(np.argmin(np.linalg.norm(np.array(tree) - aim, axis=1)))]
    away = aim - nearest
    length = float(np.max(np.abs(away)))
    end = aim if length <= reach_rad else nearest + away * (reach_rad / length)
    count = max(1, int(np.ceil(np.max(np.abs(end - nearest)) / CHECK_RAD)))
    if any(collides(nearest + (end - nearest) * (i / count)) for i in range(count, 0, -1)):
        return None
    tree.append(end)
    return end
