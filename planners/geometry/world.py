"""A scene's objects as shapes of coal, and what is refused of them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Box, Cone, Cylinder, Mesh, Plane, Pose, Scene, SceneObject, Shape, Sphere

Vector = NDArray[np.float64]

# A tree over this many triangles takes half a second to build and 100 MB; a scan of a workshop has fewer.
MAX_TRIANGLES = 200_000

# Each shape adds a pair with every link; this many still build within 50 ms.
MAX_SHAPES = 1000

# Shapes further off or larger than this are no concern of an arm, and the search for common points loses its digits.
MAX_LENGTH_M = 100.0

# A quaternion shorter than this has no direction left; others are brought to length 1.
SHORTEST_QUATERNION = 1e-6

# Twice the area of a triangle that has none [m^2].
NO_AREA_M2 = 1e-14


def check_scene(scene: Scene, links: Collection[str]) -> PlanningFailure | None:
    """What is wrong with a scene, or None.

    Args:
        scene: the scene.
        links: names of the robot's links.
    """
    held = [attached.object for attached in scene.attached]
    objects = [*scene.objects, *held]
    return (
        _check_names([thing.name for thing in objects], links)
        or _check_links(scene, links)
        or _check_count(objects)
        or next((refusal for thing in objects for refusal in _object_refusals(thing)), None)
        or _check_thickness(scene)
    )


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


def _check_names(names: list[str], links: Collection[str]) -> PlanningFailure | None:
    seen: set[str] = set()
    for name in names:
        if not name:
            return PlanningFailure(MoveItErrorCode.INVALID_OBJECT_NAME, "an object of the scene has no name")
        if name in seen or name in links:
            other = "another object of the scene" if name in seen else "a link of the robot"
            return PlanningFailure(
                MoveItErrorCode.INVALID_OBJECT_NAME, f"the object {name!r} has the name of {other}", {"object": name}
            )
        seen.add(name)
    return None


def _check_links(scene: Scene, links: Collection[str]) -> PlanningFailure | None:
    named = [(f"the link that holds {held.object.name!r}", held.link) for held in scene.attached]
    named += [
        (f"a link that may touch {held.object.name!r}", link) for held in scene.attached for link in held.touch_links
    ]
    named += [("a padded link", link) for link in scene.link_padding_m]
    named += [("a scaled link", link) for link in scene.link_scale]
    for what, link in named:
        if link not in links:
            known = ", ".join(links)
            return PlanningFailure(
                MoveItErrorCode.INVALID_LINK_NAME,
                f"{what} is {link!r}, which the robot does not have; it has: {known}",
                {"link": link},
            )
    return None


def _check_count(objects: list[SceneObject]) -> PlanningFailure | None:
    count = sum(len(thing.shapes) for thing in objects)
    if count > MAX_SHAPES:
        return _refusal(f"the scene has {count} shapes, more than {MAX_SHAPES}", shapes=count, limit=MAX_SHAPES)
    return None


def _check_thickness(scene: Scene) -> PlanningFailure | None:
    for link, padding_m in scene.link_padding_m.items():
        if not 0.0 <= padding_m <= MAX_LENGTH_M:
            return _refusal(
                f"the padding of link {link!r} must be 0 to {MAX_LENGTH_M:g} m, not {padding_m:g}", link=link
            )
    for link, factor in scene.link_scale.items():
        if not (math.isfinite(factor) and factor > 0.0):
            return _refusal(f"the scale of link {link!r} must be a finite number above 0, not {factor:g}", link=link)
    return None


def _object_refusals(thing: SceneObject) -> Iterator[PlanningFailure]:
    """Everything that is wrong with one object, one sentence each."""
    subject = f"the object {thing.name!r}"
    if not thing.shapes:
        yield _refusal(f"{subject} has no shape", object=thing.name)
    said = [_pose_fault(thing.pose)]
    for shape, pose in thing.shapes:
        said += [_shape_fault(shape), _pose_fault(pose)]
    for fault in said:
        if fault is not None:
            yield _refusal(f"{subject} {fault}", object=thing.name)


def _pose_fault(pose: Pose) -> str | None:
    if not _within(pose.position_m, -MAX_LENGTH_M):
        return f"has a position that is not finite or beyond {MAX_LENGTH_M:g} m: {pose.position_m}"
    length = math.hypot(*pose.orientation)
    if not (math.isfinite(length) and length >= SHORTEST_QUATERNION):
        return f"has an orientation that is no quaternion: {pose.orientation}"
    return None


def _shape_fault(shape: Shape) -> str | None:
    match shape:
        case Box():
            return _size_fault("box", shape.size_m)
        case Sphere():
            return _size_fault("sphere", (shape.radius_m,))
        case Cylinder():
            return _size_fault("cylinder", (shape.radius_m, shape.height_m))
        case Cone():
            return _size_fault("cone", (shape.radius_m, shape.height_m))
        case Plane():
            return _plane_fault(shape)
        case Mesh():
            return _mesh_fault(shape)


def _size_fault(kind: str, sizes_m: tuple[float, ...]) -> str | None:
    if _within(sizes_m, 0.0) and all(size_m > 0.0 for size_m in sizes_m):
        return None
    return f"is a {kind} whose sizes are not all above 0 and at most {MAX_LENGTH_M:g} m: {sizes_m}"


def _plane_fault(plane: Plane) -> str | None:
    length = math.hypot(*plane.normal)
    if not (math.isfinite(length) and length >= SHORTEST_QUATERNION):
        return f"is a plane whose normal has no direction: {plane.normal}"
    if not _within((plane.offset_m,), -MAX_LENGTH_M):
        return f"is a plane whose offset is not finite or beyond {MAX_LENGTH_M:g} m: {plane.offset_m}"
    return None


def _mesh_fault(mesh: Mesh) -> str | None:
    vertices_m, triangles = np.asarray(mesh.vertices_m), np.asarray(mesh.triangles)
    if vertices_m.ndim != 2 or triangles.ndim != 2 or vertices_m.shape[1] != 3 or triangles.shape[1] != 3:
        return f"is a mesh of vertices {vertices_m.shape} and triangles {triangles.shape}, not (n, 3) and (m, 3)"
    if not 0 < len(triangles) <= MAX_TRIANGLES:
        return f"is a mesh of {len(triangles)} triangles, not 1 to {MAX_TRIANGLES}"
    if not np.all(np.abs(vertices_m) <= MAX_LENGTH_M):
        return f"is a mesh with vertices that are not finite or beyond {MAX_LENGTH_M:g} m"
    if triangles.min() < 0 or triangles.max() >= len(vertices_m):
        return f"is a mesh whose triangles name vertices {triangles.min()} to {triangles.max()} of {len(vertices_m)}"
    a, b, c = (vertices_m[triangles[:, k]] for k in range(3))
    if not np.any(np.linalg.norm(np.cross(b - a, c - a), axis=1) > NO_AREA_M2):
        return "is a mesh whose triangles have no area"
    return None


def _within(values: tuple[float, ...], lowest: float) -> bool:
    return all(lowest <= value <= MAX_LENGTH_M for value in values)


def _refusal(message: str, **details: str | float) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, message, details)
