"""Robot and scene as the planning libraries take them: a plain URDF, and shapes of the robot's links and of a scene."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.errors import ShapeError
from planners.scene import Box, Cone, Cylinder, Mesh, Plane, Point, Pose, Shape, Sphere
from robot.description.meshes import with_mesh_paths
from robot.description.model import Joint, RobotModel
from robot.description.urdf import shift_origin
from robot.errors import DescriptionError
from robot.trajectory import Vector

_EFFORT = "1"  # libraries want an effort limit, which nothing here reads


def plain_urdf(robot: RobotModel) -> str:
    """URDF text without visuals and with plain joints, position limits as the model has them.

    Continuous joints become revolute ones, which :mod:`robot.description.urdf` limits: pinocchio would otherwise
    describe each by two numbers. Joints that mimic become plain ones, with their offset in their origin: so that their
    position is a multiple of the other's. Floating and planar joints are fixed.
    """
    root = ET.fromstring(robot.urdf)  # noqa: S314 - the user's own file, already parsed by robot.description.urdf
    for link in root.iterfind("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for element in root.iterfind("joint"):
        joint = robot.joints[element.get("name", "")]
        if joint.mimic is not None and joint.mimic.offset != 0.0:
            shift_origin(element, joint.mimic.offset)
        for mimic in element.findall("mimic"):
            element.remove(mimic)
        if joint.moves:
            _set_limits(element, joint, robot)
        elif joint.type != "fixed":
            element.set("type", "fixed")
    return ET.tostring(root, encoding="unicode")


def kinematic_urdf(robot: RobotModel) -> str:
    """As :func:`plain_urdf`, without shapes, whose meshes placo loads anyway (seconds and half a gigabyte)."""
    root = ET.fromstring(plain_urdf(robot))  # noqa: S314 - made above
    for link in root.iterfind("link"):
        for shape in link.findall("collision"):
            link.remove(shape)
    return ET.tostring(root, encoding="unicode")


def _set_limits(element: ET.Element, joint: Joint, robot: RobotModel) -> None:
    lower, upper = joint.lower, joint.upper
    if joint.mimic is not None:
        leader = robot.joints[joint.mimic.joint]
        lower, upper = sorted((joint.mimic.multiplier * leader.lower, joint.mimic.multiplier * leader.upper))
    limit = element.find("limit")
    if limit is None:
        limit = ET.SubElement(element, "limit", effort=_EFFORT, velocity="1")
    limit.set("lower", repr(lower))
    limit.set("upper", repr(upper))
    if joint.type == "continuous":
        element.set("type", "revolute")


# A check's time grows with the corners: hulls of the SO-101's meshes have thousands, which take five times as long.
MAX_CORNERS = 250

# A hull around faces in 126 directions has at most 248 corners and is 1 to 2 mm wider than links of 10 cm.
DIRECTIONS = 126

MANY_POINTS = 10_000  # the hull of 25,000 points of a ball takes 0.25 s, their heights in all directions 5 ms

FLAT = 1e-6  # points whose least extent is below this share of their greatest are flat
PLATE_M = 1e-4  # half the thickness of a plate around flat points: nothing to an arm, and enough for coal [m]

# Faces closer together than this share of the hull's size are one: corners between them are not to be had.
SAME_CORNER = 1e-7


def convex(points: Vector) -> coal.Convex:
    """Return the hull of finite points, shape (n, 3), n >= 1 [m]; for flat points, a plate that encloses them."""
    # For the hull of flat points coal ends the process.
    if _thickness(points) < FLAT:
        points = (points[:, np.newaxis] + PLATE_M * np.vstack((np.eye(3), -np.eye(3)))).reshape(-1, 3)
    vertices = coal.StdVec_Vec3s()
    vertices.extend(list(points))
    return coal.Convex.convexHull(vertices, True, "Qt")


def enclosing(points: Vector) -> coal.Convex:
    """Return a hull that encloses points, as for :func:`convex`, and has few corners: their own where those are few."""
    corners = points
    if len(points) < MANY_POINTS or _thickness(points) < FLAT:
        # RuntimeError: one corner has more neighbours than coal counts, as the tip of a fine cone.
        with suppress(RuntimeError):
            hull = convex(points)
            corners = np.asarray(hull.points())
            if len(corners) <= MAX_CORNERS:
                return hull
    # Evenly spread directions suit a body as wide as long, so the body is seen in its own proportions. Corners of the
    # solid {x : d . x <= h} are, from a point in it, the faces of the hull of d / h.
    middle, size = corners.mean(axis=0), np.ptp(corners, axis=0)
    directions = evenly_spread(DIRECTIONS)
    heights = ((corners - middle) / size @ directions.T).max(axis=0)
    dual = convex(directions / heights[:, np.newaxis])
    triangles = np.asarray(dual.points())[_triangles(dual)]
    regular = np.abs(np.linalg.det(triangles * heights.mean())) > SAME_CORNER
    solid = np.linalg.solve(triangles[regular], np.ones((regular.sum(), 3, 1)))[:, :, 0]
    return convex(solid * size + middle)


def _thickness(points: Vector) -> float:
    """Least extent of points as a share of their greatest, along their principal axes."""
    centred = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    extents = np.ptp(centred @ axes, axis=0)
    return float(extents.min() / extents.max()) if extents.max() > 0.0 else 0.0


def _triangles(hull: coal.Convex) -> NDArray[np.int64]:
    polygons = (hull.polygons(i) for i in range(hull.num_polygons))
    return np.array([(polygon[0], polygon[1], polygon[2]) for polygon in polygons])


def evenly_spread(count: int) -> Vector:
    """Return unit vectors, shape (count, 3): the six along the axes, then a Fibonacci lattice."""
    i = np.arange(count - 6) + 0.5
    z = 1.0 - 2.0 * i / (count - 6)
    angle = np.pi * (1.0 + np.sqrt(5.0)) * i
    ring = np.sqrt(1.0 - z**2)
    lattice = np.stack((ring * np.cos(angle), ring * np.sin(angle), z), axis=1)
    return np.vstack((np.eye(3), -np.eye(3), lattice))


def robot_shapes(
    robot: RobotModel, model: pin.Model, urdf: Sequence[pin.GeometryObject] | None = None
) -> list[pin.GeometryObject]:
    """Return the solid shapes that are checked: hulls, else the URDF's with hulls for meshes. ShapeError: none."""
    shapes = [on_link(model, link, convex(hull.vertices)) for link, hull in robot.hulls.items()]
    shapes = shapes or [without_triangles(shape) for shape in (urdf_shapes(robot, model) if urdf is None else urdf)]
    if not shapes:
        raise ShapeError(robot.name, "no link has a collision shape")
    return shapes


def urdf_shapes(robot: RobotModel, model: pin.Model) -> list[pin.GeometryObject]:
    """Return the shapes of the URDF, meshes with all their triangles; ShapeError: a shape cannot be loaded."""
    try:
        urdf = with_mesh_paths(plain_urdf(robot), robot.mesh_directory, robot.package_directories)
        geometry = pin.buildGeomFromUrdfString(model, urdf, pin.GeometryType.COLLISION)
    except (DescriptionError, ValueError, RuntimeError) as error:
        # coal's text names its own file and line first; its hint about directories is wrong: the file was found.
        reason = " ".join(str(error).rpartition("message: ")[2].partition("Hint:")[0].split())
        raise ShapeError(robot.name, f"cannot be loaded: {reason}") from error
    shapes = list(geometry.geometryObjects)
    for shape in shapes:
        if isinstance(shape.geometry, coal.BVHModelBase) and not np.isfinite(shape.geometry.vertices()).all():
            raise ShapeError(robot.name, f"cannot be loaded: a vertex of {shape.meshPath} is no finite number")
    return shapes


def frame_of_link(model: pin.Model, link: str) -> int:
    """Return the index of a link's frame; a joint may have the link's name."""
    return int(model.getFrameId(link, pin.FrameType.BODY))


def link_name(model: pin.Model, shape: pin.GeometryObject) -> str:
    """Name of the link that carries a shape."""
    return str(model.frames[shape.parentFrame].name)


def outline(shape: pin.GeometryObject) -> Vector:
    """Points whose hull encloses a shape, shape (n, 3) [m], in the frame of the joint that carries the shape."""
    return corners(shape.geometry) @ shape.placement.rotation.T + shape.placement.translation


def scaled(shape: coal.CollisionGeometry, factor: float) -> coal.Convex:
    """The hull of a shape's outline, larger by a factor as seen from its middle."""
    points = corners(shape)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return convex(middle + factor * (points - middle))


def on_link(model: pin.Model, link: str, shape: coal.CollisionGeometry) -> pin.GeometryObject:
    """A shape in the frame of a link."""
    frame_id = frame_of_link(model, link)
    frame = model.frames[frame_id]
    return pin.GeometryObject(link, frame.parentJoint, frame_id, frame.placement, shape)


def without_triangles(shape: pin.GeometryObject) -> pin.GeometryObject:
    """Return a shape, or a hull in place of a mesh."""
    if not isinstance(shape.geometry, coal.BVHModelBase):
        return shape
    hull = enclosing(np.asarray(shape.geometry.vertices()))
    return pin.GeometryObject(shape.name, shape.parentJoint, shape.parentFrame, shape.placement, hull)


def corners(shape: coal.CollisionGeometry) -> Vector:
    """Points whose hull encloses a shape, shape (n, 3) [m], in its own frame."""
    if isinstance(shape, coal.Convex):
        return np.asarray(shape.points())
    if isinstance(shape, coal.BVHModelBase):
        return np.asarray(shape.vertices())
    shape.computeLocalAABB()
    lower, upper = shape.aabb_local.min_, shape.aabb_local.max_
    return np.array(np.meshgrid(*zip(lower, upper, strict=True))).reshape(3, -1).T


def placement(pose: Pose) -> pin.SE3:
    """A pose as pinocchio has it."""
    x, y, z, w = pose.orientation
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized(), np.array(pose.position_m))


def as_pose(place: pin.SE3) -> Pose:
    """A pose of pinocchio as plain data."""
    x, y, z, w = pin.Quaternion(place.rotation).coeffs().tolist()
    return Pose(as_point(place.translation), (x, y, z, w))


def as_point(vector: Vector) -> Point:
    """A vector of shape (3,) as plain data."""
    x, y, z = vector.tolist()
    return x, y, z


def solid(shape: Shape, reach_m: float) -> tuple[coal.CollisionGeometry, pin.SE3]:
    """Return a sound shape as coal has it, and its place; a plane only as far as ``reach_m`` from its origin."""
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
            return triangle_tree(np.asarray(shape.vertices_m), np.asarray(shape.triangles)), pin.SE3.Identity()


def _slab(plane: Plane, reach_m: float) -> tuple[coal.CollisionGeometry, pin.SE3]:
    """The half-space as far as the robot reaches: coal's own is missed by its broad phase when padded."""
    normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), normal).toRotationMatrix()
    edge_m = 4.0 * (reach_m + abs(plane.offset_m))
    return coal.Box(edge_m, edge_m, edge_m), pin.SE3(turn, normal * (plane.offset_m - 0.5 * edge_m))


def triangle_tree(vertices_m: Vector, triangles: NDArray[np.integer[Any]]) -> coal.BVHModelOBBRSS:
    """Return a search tree over triangles, shape (m, 3), indices into vertices, shape (n, 3) [m]."""
    surface = coal.BVHModelOBBRSS()
    surface.beginModel(len(triangles), len(vertices_m))
    surface.addVertices(np.asarray(vertices_m, dtype=np.float64))
    surface.addTriangles(np.asarray(triangles, dtype=np.int64))
    surface.endModel()
    return surface
