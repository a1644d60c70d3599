"""Collision objects as bodies of the physics."""

import math
from typing import Any

import numpy as np

from planners.scene import Box, Cone, Cylinder, Mesh, Plane, Pose, Shape, Sphere
from robot.physics.bodies import MAX_HULL_CORNERS, Body, BodyShape
from robot.trajectory import Vector
from server.moveit.scene.collision_objects import CollisionObject
from server.moveit.scene.frames import in_root

CONE_SIDES = 24  # of the prism that stands for a cone


def body_of(each: CollisionObject) -> Body:
    """Return the body of an object at its pose, which stays where it is."""
    shapes = tuple(_body_shape(*shape) for shape in each.shapes)
    return Body(each.name, shapes, each.pose.position_m, each.pose.orientation)


def _body_shape(shape: Shape, pose: Pose) -> BodyShape:
    """Return the shape of a body; a mesh has its convex hull, and a cone is a pyramid of many sides."""
    at = pose.position_m, pose.orientation
    match shape:
        case Box(size_m):
            return BodyShape("box", tuple(0.5 * edge for edge in size_m), *at)
        case Sphere(radius_m):
            return BodyShape("sphere", (radius_m,), *at)
        case Cylinder(radius_m, height_m):
            return BodyShape("cylinder", (radius_m, 0.5 * height_m), *at)
        case Plane(normal, offset_m):
            return BodyShape("plane", (), *_plane_pose(pose, normal, offset_m))
        case Cone(radius_m, height_m):
            angles = np.linspace(0.0, math.tau, CONE_SIDES, endpoint=False).tolist()
            foot = [(radius_m * math.cos(each), radius_m * math.sin(each), -0.5 * height_m) for each in angles]
            return BodyShape("hull", (), *at, ((0.0, 0.0, 0.5 * height_m), *foot))
        case Mesh():
            corners = _outermost(shape.vertices_m).tolist()
            return BodyShape("hull", (), *at, tuple((x, y, z) for x, y, z in corners))


def _outermost(points_m: Vector) -> Vector:
    """Return the corners of a convex hull, or of one inside it whose corners are the outermost in many directions."""
    points = np.unique(points_m, axis=0)
    if len(points) <= MAX_HULL_CORNERS:
        return points
    # Directions on a Fibonacci sphere, which cover it evenly.
    index = np.arange(MAX_HULL_CORNERS) + 0.5
    z, turn = 1.0 - 2.0 * index / MAX_HULL_CORNERS, math.pi * (1.0 + math.sqrt(5.0)) * index
    level = np.sqrt(1.0 - z * z)
    directions = np.column_stack((level * np.cos(turn), level * np.sin(turn), z))
    outermost: Vector = points[np.unique(np.argmax(points @ directions.T, axis=0))]
    return outermost


def _plane_pose(pose: Pose, normal: tuple[float, float, float], offset_m: float) -> tuple[Any, Any]:
    """Return position and orientation of a plane whose z axis is the normal: the shortest turn from z to it."""
    x, y, z = normal
    length = math.hypot(1.0 + z, x, y)
    turn = (-y / length, x / length, 0.0, (1.0 + z) / length) if z > -1.0 + 1e-9 else (1.0, 0.0, 0.0, 0.0)
    at = in_root(pose, Pose((offset_m * x, offset_m * y, offset_m * z), turn))
    return at.position_m, at.orientation
