"""Draw the benchmark's own problems: ``python -m benchmarks.make_scenes``, writes ``benchmarks/scenes/*.json``.

A problem counts as feasible once a slow search in the official meshes has found a path, so that the planners under test
have no influence on the problems. Needs the reference data beside the checkout.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scene_things import Arrangement, Fields, arrangements
from harness.full_meshes import Judge
from harness.server import REFERENCE

Vector = NDArray[np.float64]

SCENES = Path(__file__).parent / "scenes"

JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
LIMITS = {
    "velocity": [3.0] * 5,
    "acceleration": [10.0] * 5,
    "lower": [-1.91986, -1.74533, -1.69, -1.65806, -2.74385],
    "upper": [1.91986, 1.74533, 1.69, 1.65806, 2.84121],
}
GRIPPER_RAD = 0.3
PROBLEMS = 12
TOLERANCE_M = 0.005

# Above the table by more than the size of the gripper's fingers.
LOWEST_TIP_M = 0.02

# Edges of the witness are checked this finely: 2 mm at the tip for the base joint.
CHECK_RAD = 0.005
EXTEND_RAD = 0.3
MAX_NODES = 3000

# A start this deep in an obstacle collides with any margin of the hulls.
MIN_TOUCHING = 20


class Draw:
    """Random problems in one scene.

    Args:
        name: of the scene.
        arrangement: what there is.
        seed: same seed, same problems.

    Attributes:
        fields: the problem file without its problems.
        judge: of what collides there.
    """

    def __init__(self, name: str, arrangement: Arrangement, seed: int) -> None:
        self._name, self._arrangement = name, arrangement
        self._rng = np.random.default_rng(seed)
        self._lower, self._upper = np.array(LIMITS["lower"]), np.array(LIMITS["upper"])
        self.fields: Fields = {
            "format": "so101-plan-bench/1",
            "name": name,
            "description": arrangement.description,
            "frame": "base_link",
            "joint_names": JOINTS,
            "gripper": GRIPPER_RAD,
            "limits": LIMITS,
            "objects": list(arrangement.objects),
            "attached": list(arrangement.attached),
        }
        self.judge = Judge(REFERENCE, self.fields)

    def file(self) -> Fields:
        """Return the content of the problem file."""
        pairs = self.connected_pairs()
        joint_problems = [
            {"id": f"{self._name}-j{i:02}", "start": _listed(start), "goal": _listed(goal)}
            for i, (start, goal) in zip(range(PROBLEMS), pairs, strict=False)
        ]
        position_problems = [
            {
                "id": f"{self._name}-p{i:02}",
                "start": _listed(start),
                "position": _listed(self.judge.tip_m(goal)),
                "tolerance": TOLERANCE_M,
                "witness_goal": _listed(goal),
            }
            for i, (start, goal) in zip(range(PROBLEMS), pairs, strict=False)
        ]
        infeasible = [
            {"id": f"{self._name}-x{i:02}", **problem} for i, problem in enumerate(self._infeasible(joint_problems[0]))
        ]
        return {
            **self.fields,
            "joint_problems": joint_problems,
            "position_problems": position_problems,
            "infeasible": infeasible,
        }

    def connected_pairs(self) -> Iterator[tuple[Vector, Vector]]:
        """Yield free starts and goals between which the slow search has found a path, without an end."""
        while True:
            start, goal = self._free(self._anywhere), self._free(self._in_region)
            if self._rng.random() < 0.5:
                start, goal = goal, start
            if _connected(self.judge.collides, start, goal, self._lower, self._upper, self._rng):
                yield start, goal

    def _infeasible(self, feasible: Fields) -> Iterator[Fields]:
        start, goal = feasible["start"], feasible["goal"]
        for _ in range(3):
            touching = _listed(self._colliding())
            yield {"kind": "goal_in_collision", "accept_codes": [-12], "start": start, "goal": touching}
        for _ in range(2):
            touching = _listed(self._colliding())
            yield {"kind": "start_in_collision", "accept_codes": [-10], "start": touching, "goal": goal}
        aim = {"start": start, "tolerance": TOLERANCE_M}
        inside = list(self._arrangement.inside)
        yield {"kind": "position_in_obstacle", "accept_codes": [-12, -31], **aim, "position": inside}
        yield {"kind": "unreachable_position", "accept_codes": [-31], **aim, "position": [0.45, 0.1, 0.5]}
        yield {"kind": "goal_beyond_joint_limit", "accept_codes": [-16], "start": start, "goal": [*goal[:4], 3.1]}
        yield {"kind": "start_beyond_joint_limit", "accept_codes": [-26], "start": [*start[:3], 2.0, 0.0], "goal": goal}
        yield {"kind": "goal_not_finite", "accept_codes": [-16], "start": start, "goal": [None, *goal[1:]]}

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
        lower, upper = self._arrangement.region
        while True:
            point = self._anywhere()
            if np.all(self.judge.tip_m(point) > lower) and np.all(self.judge.tip_m(point) < upper):
                return point

    def _colliding(self) -> Vector:
        """Draw a pose with the tip above the table and links deep in an obstacle."""
        while True:
            point = self._anywhere()
            around = point + self._rng.normal(scale=0.05, size=(MIN_TOUCHING, 5))
            if self.judge.collides(point) and all(self.judge.collides(near) for near in around):
                return point


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


def _listed(values: Vector) -> list[float]:
    return [round(float(value), 6) for value in values]


def main() -> None:
    """Write every scene."""
    SCENES.mkdir(exist_ok=True)
    for seed, (name, arrangement) in enumerate(arrangements().items()):
        (SCENES / f"{name}.json").write_text(json.dumps(Draw(name, arrangement, seed).file()) + "\n")
        print(f"{name}: written")


if __name__ == "__main__":
    main()
