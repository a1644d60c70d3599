"""Surroundings for tests of collisions."""

from itertools import count

import numpy as np

from planners.geometry.kinematics import ForwardKinematics
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


def boxes(count):
    """Small boxes out of reach of a small arm."""
    return tuple(thing(Box((0.01, 0.01, 0.01)), 2.0 + 0.02 * i, 0.0, 0.0, name=f"box {i}") for i in range(count))


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


def outside_m(hull, points):
    """Return the distance of each point from a hull, below 0 inside of it, shape (n,)."""
    corners = np.asarray(hull.points())
    triangles = [hull.polygons(i) for i in range(hull.num_polygons)]
    a, b, c = (corners[[triangle[k] for triangle in triangles]] for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals, a = normals[lengths > 1e-14] / lengths[lengths > 1e-14, None], a[lengths > 1e-14]
    heights = (normals * a).sum(axis=1)
    outwards = np.sign(heights - normals @ corners.mean(axis=0))
    return ((points @ normals.T - heights) * outwards).max(axis=1)


def tip_positions_m(collision, configurations, link):
    """Origin of a link in each configuration, shape (n, 3) [m]."""
    return ForwardKinematics(collision._robot, collision.joint_names).placements(configurations, link).positions_m
