"""A scene's shapes as shapes of coal."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from planners.scene import Box, Cone, Cylinder, Mesh, Plane, Pose, Shape, Sphere


def placement(pose: Pose) -> pin.SE3:
    """A pose as pinocchio has it."""
    x, y, z, w = pose.orientation
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized(), np.array(pose.position_m))


def solid(shape: Shape, reach_m: float) -> tuple[coal.CollisionGeometry, pin.SE3]:
    """A shape as coal has it, and its place in the frame of the scene's shape.

    Args:
        shape: a shape that :func:`check_scene` accepts.
        reach_m: points further than this from the frame's origin can be left out of a plane [m].
    """
    match shape:
        case Box():
            return coal.Box(*shape.size_m), pin.SE3.Identity()
        case Sphere():
            return coal.Sphere(shape.radius_m), pin.SE3.Identity()
        case Cylinder():
            return coal.Cylinder(shape.radius_m, shape.height_m), pin.SE3.Identity()
        case Cone():
            return coal.Cone(shape.radius_m, shape.height_m), pin.SE3.Identity()
        case Plane():
            return _slab(shape, reach_m)
        case Mesh():
            return _surface(shape), pin.SE3.Identity()


def _slab(plane: Plane, reach_m: float) -> tuple[coal.CollisionGeometry, pin.SE3]:
    """The half-space as far as the robot reaches: coal's own is missed by its broad phase when padded."""
    normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), normal).toRotationMatrix()
    edge_m = 4.0 * (reach_m + abs(plane.offset_m))
    return coal.Box(edge_m, edge_m, edge_m), pin.SE3(turn, normal * (plane.offset_m - 0.5 * edge_m))


def _surface(mesh: Mesh) -> coal.BVHModelOBBRSS:
    surface = coal.BVHModelOBBRSS()
    surface.beginModel(len(mesh.triangles), len(mesh.vertices_m))
    surface.addVertices(np.asarray(mesh.vertices_m, dtype=np.float64))
    surface.addTriangles(np.asarray(mesh.triangles, dtype=np.int64))
    surface.endModel()
    return surface
