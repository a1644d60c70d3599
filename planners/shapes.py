"""Collision shapes of a robot: one convex shape per link, or the URDF's own with meshes replaced by their hulls."""

from __future__ import annotations

from itertools import combinations

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.errors import ShapeError
from robot.model import Hull, RobotModel

Vector = NDArray[np.float64]


def collision_geometry(robot: RobotModel, model: pin.Model) -> pin.GeometryModel:
    """Shapes and the pairs of them to check.

    Raises:
        ShapeError: a shape of the URDF cannot be loaded, or there is none.
    """
    geometry = _from_hulls(robot, model) if robot.hulls else _from_urdf(robot, model)
    if geometry.ngeoms == 0:
        raise ShapeError(robot.name, "no link has a collision shape")
    _add_pairs(robot, model, geometry)
    return geometry


def link_name(model: pin.Model, shape: pin.GeometryObject) -> str:
    """Name of the link that carries a shape."""
    return str(model.frames[shape.parentFrame].name)


def outline(shape: pin.GeometryObject) -> Vector:
    """Points whose hull encloses a shape.

    Returns:
        Shape (n, 3) [m], in the frame of the joint that carries the shape.
    """
    return np.asarray([shape.placement.act(point) for point in _outline_in_shape(shape.geometry)])


def _from_hulls(robot: RobotModel, model: pin.Model) -> pin.GeometryModel:
    geometry = pin.GeometryModel()
    for link, hull in robot.hulls.items():
        frame_id = model.getFrameId(link)
        frame = model.frames[frame_id]
        geometry.addGeometryObject(
            pin.GeometryObject(link, frame.parentJoint, frame_id, frame.placement, _convex(hull))
        )
    return geometry


def _convex(hull: Hull) -> coal.Convex:
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for vertex in hull.vertices:
        points.append(vertex)
    for a, b, c in hull.triangles:
        triangles.append(coal.Triangle(int(a), int(b), int(c)))
    return coal.Convex(points, triangles)


def _from_urdf(robot: RobotModel, model: pin.Model) -> pin.GeometryModel:
    # package:// names start above the package's own directory, relative names in it.
    folders = [] if robot.mesh_directory is None else [str(robot.mesh_directory), str(robot.mesh_directory.parent)]
    try:
        geometry = pin.buildGeomFromUrdfString(model, robot.urdf, pin.GeometryType.COLLISION, package_dirs=folders)
    except (ValueError, RuntimeError) as error:
        raise ShapeError(robot.name, f"cannot be loaded: {error}") from error
    for shape in geometry.geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):
            shape.geometry = _hull_of_mesh(link_name(model, shape), shape.geometry)
    return geometry


def _hull_of_mesh(link: str, mesh: coal.BVHModelBase) -> coal.Convex:
    """Hull of a mesh: far cheaper to check, and it encloses the mesh."""
    try:
        mesh.buildConvexHull(True, "Qt")
    except RuntimeError as error:
        raise ShapeError(link, f"the mesh has no convex hull: {error}") from error
    return mesh.convex


def _add_pairs(robot: RobotModel, model: pin.Model, geometry: pin.GeometryModel) -> None:
    adjacent = {frozenset((joint.parent, joint.child)) for joint in robot.joints.values()}
    unchecked = adjacent | robot.disabled_pairs
    for (i, first), (j, second) in combinations(enumerate(geometry.geometryObjects), 2):
        links = frozenset((link_name(model, first), link_name(model, second)))
        if first.parentJoint != second.parentJoint and links not in unchecked:
            geometry.addCollisionPair(pin.CollisionPair(i, j))


def _outline_in_shape(shape: coal.CollisionGeometry) -> Vector:
    if isinstance(shape, coal.Convex):
        return np.asarray(shape.points())
    shape.computeLocalAABB()
    lower, upper = shape.aabb_local.min_, shape.aabb_local.max_
    corners = np.array(np.meshgrid(*zip(lower, upper, strict=True)))
    return corners.reshape(3, -1).T
