"""Collision shapes of a robot: one convex shape per link, or the URDF's own with meshes replaced by hulls."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.errors import ShapeError
from planners.geometry.hulls import convex, enclosing
from robot.description.model import RobotModel

Vector = NDArray[np.float64]


def robot_shapes(robot: RobotModel, model: pin.Model) -> list[pin.GeometryObject]:
    """The shapes that are checked: solid and quick to check.

    Raises:
        ShapeError: a shape of the URDF cannot be loaded, or there is none.
    """
    shapes = [on_link(model, link, convex(hull.vertices)) for link, hull in robot.hulls.items()]
    shapes = shapes or _from_urdf(robot, model)
    if not shapes:
        raise ShapeError(robot.name, "no link has a collision shape")
    return shapes


def urdf_shapes(robot: RobotModel, model: pin.Model) -> list[pin.GeometryObject]:
    """The shapes of the URDF as they are, meshes with all their triangles.

    Raises:
        ShapeError: a shape cannot be loaded.
    """
    # package:// names start above the package's own directory, relative names in it.
    folders = [] if robot.mesh_directory is None else [str(robot.mesh_directory), str(robot.mesh_directory.parent)]
    try:
        geometry = pin.buildGeomFromUrdfString(model, robot.urdf, pin.GeometryType.COLLISION, package_dirs=folders)
    except (ValueError, RuntimeError) as error:
        raise ShapeError(robot.name, f"cannot be loaded: {error}") from error
    return list(geometry.geometryObjects)


def link_name(model: pin.Model, shape: pin.GeometryObject) -> str:
    """Name of the link that carries a shape."""
    return str(model.frames[shape.parentFrame].name)


def outline(shape: pin.GeometryObject) -> Vector:
    """Points whose hull encloses a shape.

    Returns:
        Shape (n, 3) [m], in the frame of the joint that carries the shape.
    """
    return _corners(shape.geometry) @ shape.placement.rotation.T + shape.placement.translation


def scaled(shape: coal.CollisionGeometry, factor: float) -> coal.Convex:
    """The hull of a shape's outline, larger by a factor as seen from its middle."""
    points = _corners(shape)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return convex(middle + factor * (points - middle))


def on_link(model: pin.Model, link: str, shape: coal.CollisionGeometry) -> pin.GeometryObject:
    """A shape in the frame of a link."""
    frame_id = model.getFrameId(link)
    frame = model.frames[frame_id]
    return pin.GeometryObject(link, frame.parentJoint, frame_id, frame.placement, shape)


def _from_urdf(robot: RobotModel, model: pin.Model) -> list[pin.GeometryObject]:
    shapes = urdf_shapes(robot, model)
    for shape in shapes:
        if isinstance(shape.geometry, coal.BVHModelBase):
            shape.geometry = enclosing(np.asarray(shape.geometry.vertices()))
    return shapes


def _corners(shape: coal.CollisionGeometry) -> Vector:
    if isinstance(shape, coal.Convex):
        return np.asarray(shape.points())
    if isinstance(shape, coal.BVHModelBase):
        return np.asarray(shape.vertices())
    shape.computeLocalAABB()
    lower, upper = shape.aabb_local.min_, shape.aabb_local.max_
    return np.array(np.meshgrid(*zip(lower, upper, strict=True))).reshape(3, -1).T
