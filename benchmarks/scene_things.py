"""Collision objects of the benchmark's own scenes, as fields of problem files [m], in the arm's root link."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Fields = dict[str, Any]
Corner = tuple[float, float, float]


@dataclass(frozen=True)
class Arrangement:
    """One scene to draw problems for.

    Attributes:
        description: phrase for the problem file.
        objects: collision objects.
        region: lower and upper corner of the difficult region, in which the tip of every second pose lies [m].
        attached: attached collision objects.
        inside: point so deep in an obstacle that open fingers do not reach around it [m].
    """

    description: str
    objects: Sequence[Fields]
    region: tuple[Corner, Corner]
    inside: Corner
    attached: Sequence[Fields] = field(default_factory=tuple)


def thing(name: str, kind: str, size: Sequence[float], middle: Sequence[float]) -> Fields:
    """Return a shape with its size as problem files have it, upright, at its middle."""
    return {"id": name, "type": kind, "dimensions": [round(float(s), 6) for s in size], "pose": _pose(middle)}


def _pose(middle: Sequence[float]) -> Fields:
    return {"position": [round(float(value), 6) for value in middle], "orientation": [0.0, 0.0, 0.0, 1.0]}


def box(name: str, lower: Corner, upper: Corner) -> Fields:
    """Return a box between two corners."""
    size = [round(b - a, 6) for a, b in zip(lower, upper, strict=True)]
    return thing(name, "box", size, tuple((a + b) / 2 for a, b in zip(lower, upper, strict=True)))


# As the table of a bench with the arm screwed on: just below its base.
TABLE = box("table", (-0.3, -0.6, -0.053), (0.7, 0.6, -0.003))
IN_TABLE = (0.24, 0.0, -0.028)


def arrangements() -> dict[str, Arrangement]:
    """Return every scene by name."""
    return {
        "shelf": _shelf(),
        "window": _window(),
        "gap": _gap(),
        "clutter": _clutter(),
        "hoop": _hoop(),
        "held_bar": _held_bar(),
    }


def _shelf() -> Arrangement:
    boards = [box(f"board{i}", (0.20, -0.17, z), (0.40, 0.17, z + 0.01)) for i, z in enumerate((0.0, 0.16, 0.32))]
    sides = [box(f"side{i}", (0.20, y, 0.01), (0.40, y + 0.01, 0.32)) for i, y in enumerate((-0.18, 0.17))]
    back = box("back", (0.40, -0.18, 0.0), (0.41, 0.18, 0.33))
    return Arrangement(
        "a shelf of two compartments, open towards the arm",
        [TABLE, *boards, *sides, back],
        ((0.22, -0.14, 0.03), (0.37, 0.14, 0.29)),
        (0.30, 0.0, 0.165),
    )


def _window() -> Arrangement:
    wall = [
        box("left", (0.22, 0.11, 0.0), (0.25, 0.45, 0.45)),
        box("right", (0.22, -0.45, 0.0), (0.25, -0.11, 0.45)),
        box("sill", (0.22, -0.11, 0.0), (0.25, 0.11, 0.12)),
        box("lintel", (0.22, -0.11, 0.30), (0.25, 0.11, 0.45)),
    ]
    return Arrangement(
        "a wall with a window of 22 by 18 cm",
        [TABLE, *wall],
        ((0.27, -0.12, 0.10), (0.40, 0.12, 0.32)),
        (0.235, 0.3, 0.2),
    )


def _gap() -> Arrangement:
    blocks = [
        box("left", (0.16, 0.06, 0.0), (0.36, 0.26, 0.30)),
        box("right", (0.16, -0.26, 0.0), (0.36, -0.06, 0.30)),
    ]
    return Arrangement(
        "two blocks with a gap of 12 cm between them",
        [TABLE, *blocks],
        ((0.18, -0.03, 0.02), (0.36, 0.03, 0.25)),
        (0.26, 0.16, 0.15),
    )


def _clutter() -> Arrangement:
    rng = np.random.default_rng(4)
    things = [TABLE]
    kinds = ("box", "cylinder", "sphere", "cone")
    for i in range(16):
        radius_m, angle = rng.uniform(0.2, 0.36), rng.uniform(-1.9, 1.9)
        height_m, width_m = rng.uniform(0.08, 0.22), rng.uniform(0.03, 0.05)
        kind = kinds[i % 4]
        size = {
            "box": [width_m, width_m, height_m],
            "cylinder": [height_m, width_m / 2],
            "sphere": [width_m / 2],
            "cone": [height_m, width_m / 2],
        }[kind]
        z = rng.uniform(0.25, 0.4) if kind == "sphere" else height_m / 2
        things.append(thing(f"{kind}{i}", kind, size, (radius_m * math.cos(angle), radius_m * math.sin(angle), z)))
    return Arrangement(
        "16 boxes, cylinders, cones and balls",
        things,
        ((0.1, -0.35, 0.02), (0.4, 0.35, 0.14)),
        IN_TABLE,
    )


def _hoop() -> Arrangement:
    vertices, triangles = _torus(0.12, 0.012, 28, 20)
    ring = {"id": "hoop", "type": "mesh", "dimensions": [], "vertices": vertices, "triangles": triangles}
    return Arrangement(
        "an upright ring of 24 cm, a mesh of 1120 triangles",
        [TABLE, {**ring, "pose": _pose((0.24, 0.0, 0.2))}],
        ((0.27, -0.08, 0.13), (0.42, 0.08, 0.28)),
        IN_TABLE,
    )


def _held_bar() -> Arrangement:
    bar = {
        **thing("bar", "cylinder", [0.14, 0.009], (0.0, 0.0, 0.02)),
        "link": "gripper_frame_link",
        "touch_links": ["gripper_link", "moving_jaw_so101_v1_link"],
    }
    bar["pose"]["orientation"] = [0.0, 0.7071067811865476, 0.0, 0.7071067811865476]
    posts = [box(f"post{i}", (0.22, y, 0.0), (0.26, y + 0.04, 0.25)) for i, y in enumerate((-0.16, 0.12))]
    return Arrangement(
        "a 14 cm bar held crosswise, two posts and a beam",
        [TABLE, *posts, box("beam", (0.22, -0.16, 0.29), (0.26, 0.16, 0.32))],
        ((0.24, -0.1, 0.05), (0.4, 0.1, 0.3)),
        (0.24, -0.14, 0.12),
        [bar],
    )


def _torus(radius_m: float, tube_m: float, around: int, across: int) -> tuple[list[list[float]], list[list[int]]]:
    """Return a ring about the x axis."""
    vertices = []
    for u in np.arange(around) * 2 * math.pi / around:
        for v in np.arange(across) * 2 * math.pi / across:
            reach_m = radius_m + tube_m * math.cos(v)
            vertices.append([tube_m * math.sin(v), reach_m * math.cos(u), reach_m * math.sin(u)])
    triangles = []
    for i in range(around):
        for j in range(across):
            a, b = i * across + j, i * across + (j + 1) % across
            c, d = (a + across) % len(vertices), (b + across) % len(vertices)
            triangles += [[a, c, b], [b, c, d]]
    return [[round(float(value), 6) for value in vertex] for vertex in vertices], triangles


def near_contacts() -> list[Fields]:
    """Return things close around the arm: pillars to reach between, a low roof and the table."""
    pillars = [
        thing(f"pillar{i}", "cylinder", (0.3, 0.012), (0.2 * math.cos(angle), 0.2 * math.sin(angle), 0.15))
        for i, angle in enumerate(np.linspace(-1.6, 1.6, 7).tolist())
    ]
    posts = [
        box(f"post{i}", (x, y, 0.0), (x + 0.03, y + 0.03, 0.25)) for i, (x, y) in enumerate(((0.3, 0.1), (0.3, -0.13)))
    ]
    return [TABLE, *pillars, *posts, box("roof", (0.05, -0.15, 0.36), (0.25, 0.15, 0.38))]
