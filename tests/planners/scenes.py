"""Surroundings for tests of collisions."""

from __future__ import annotations

from itertools import count

import numpy as np

from planners.scene import Box, Cone, Cylinder, Mesh, Plane, Pose, Scene, SceneObject, Sphere

# Scenes are told apart by their version, so no two tests may share one.
VERSIONS = count(1000)

CORNERS_M = 0.1 * np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
FACES = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], dtype=np.int32)
SHAPES = (
    Box((0.05, 0.1, 0.2)),
    Sphere(0.05),
    Cylinder(0.03, 0.2),
    Cone(0.05, 0.1),
    Mesh(CORNERS_M, FACES),
    Plane((0.0, 0.6, 0.8), -0.3),
)


def scene(*objects, **parts):
    return Scene(next(VERSIONS), objects, **parts)


def thing(shape, *position_m, name="thing"):
    return SceneObject(name, ((shape, Pose()),), Pose(position_m or (0.0, 0.0, 0.0)))


def around_the_arm(seed):
    """Objects of every shape in reach of a small arm."""
    rng = np.random.default_rng(seed)
    things = []
    for i, shape in enumerate(SHAPES):
        orientation = rng.normal(size=4)
        pose = Pose(
            tuple(rng.uniform((0.1, -0.4, 0.0), (0.5, 0.4, 0.5))), tuple(orientation / np.linalg.norm(orientation))
        )
        things.append(SceneObject(f"thing {i}", ((shape, Pose()),), Pose() if isinstance(shape, Plane) else pose))
    return scene(*things)
