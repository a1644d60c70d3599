"""Checks of a scene: names, links, sizes, poses and counts, before any planning library sees it."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Box, Cone, Cylinder, Mesh, Plane, Pose, Scene, SceneObject, Shape, Sphere

MAX_TRIANGLES = 80_000  # a tree over this many triangles takes 0.2 s to build and 40 MB; a scan of a workshop has fewer

# All meshes of a scene together: as JSON they have 7 MB, and clients are sent a whole scene in one message.
MAX_SCENE_TRIANGLES = 160_000

MAX_SHAPES = 1000  # each shape adds a pair with every link; this many still build within 50 ms

# Shapes further off or larger than this are no concern of an arm, and the search for common points loses its digits.
MAX_LENGTH_M = 100.0

SHORTEST_QUATERNION = 1e-6  # a quaternion shorter than this has no direction left; others are brought to length 1
NO_AREA_M2 = 1e-14  # twice the area of a triangle that has none [m^2]


def check_scene(scene: Scene, links: Collection[str]) -> PlanningFailure | None:
    """Check a scene for a robot of some links; return the failure, or None."""
    refusals = (refusal for each in scene.all_objects() for refusal in _object_refusals(each))
    return check_whole(scene, links) or next(refusals, None)


def check_whole(scene: Scene, links: Collection[str]) -> PlanningFailure | None:
    """Check a scene apart from its shapes and poses; return the failure, or None. Quick, for many small changes."""
    objects = scene.all_objects()
    names = [scene_object.name for scene_object in objects]
    return _check_names(names, links) or _check_links(scene, links) or _check_count(objects) or _check_thickness(scene)


def pose_fault(pose: Pose) -> str | None:
    """Return the fault of a pose, as the end of a sentence about its owner; None for a sound one."""
    if not _within(pose.position_m, -MAX_LENGTH_M):
        return f"has a position that is not finite or beyond {MAX_LENGTH_M:g} m: {pose.position_m}"
    length = math.hypot(*pose.orientation)
    if not (math.isfinite(length) and length >= SHORTEST_QUATERNION):
        return f"has an orientation that is no quaternion: {pose.orientation}"
    return None


def shape_fault(shape: Shape) -> str | None:
    """Return the fault of a shape, as the end of a sentence about its owner; None for a sound one."""
    sizes_m: tuple[float, ...]
    match shape:
        case Plane():
            return _plane_fault(shape)
        case Mesh():
            return _mesh_fault(shape)
        case Box():
            sizes_m = shape.size_m
        case Sphere():
            sizes_m = (shape.radius_m,)
        case Cylinder() | Cone():
            sizes_m = (shape.radius_m, shape.height_m)
    if _within(sizes_m, 0.0) and all(size_m > 0.0 for size_m in sizes_m):
        return None
    kind = type(shape).__name__.lower()
    return f"is a {kind} whose sizes are not all above 0 and at most {MAX_LENGTH_M:g} m: {sizes_m}"


def _check_names(names: list[str], links: Collection[str]) -> PlanningFailure | None:
    seen: set[str] = set()
    for name in names:
        if not name:
            return PlanningFailure(MoveItErrorCode.INVALID_OBJECT_NAME, "an object of the scene has no name")
        if name in seen or name in links:
            other = "another object of the scene" if name in seen else "a link of the robot"
            text = f"the object {name!r} has the name of {other}"
            return PlanningFailure(MoveItErrorCode.INVALID_OBJECT_NAME, text, {"object": name})
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
            text = f"{what} is {link!r}, which the robot does not have; it has: {', '.join(links)}"
            return PlanningFailure(MoveItErrorCode.INVALID_LINK_NAME, text, {"link": link})
    return None


def _check_count(objects: Sequence[SceneObject]) -> PlanningFailure | None:
    count = sum(len(scene_object.shapes) for scene_object in objects)
    if count > MAX_SHAPES:
        return _refusal(f"the scene has {count} shapes, more than {MAX_SHAPES}", shapes=count, limit=MAX_SHAPES)
    triangles = sum(
        len(shape.triangles) for scene_object in objects for shape, _ in scene_object.shapes if isinstance(shape, Mesh)
    )
    if triangles > MAX_SCENE_TRIANGLES:
        text = f"the scene's meshes have {triangles} triangles, more than {MAX_SCENE_TRIANGLES}"
        return _refusal(text, triangles=triangles, limit=MAX_SCENE_TRIANGLES)
    return None


def _check_thickness(scene: Scene) -> PlanningFailure | None:
    for link, padding_m in scene.link_padding_m.items():
        if not 0.0 <= padding_m <= MAX_LENGTH_M:
            text = f"the padding of link {link!r} must be 0 to {MAX_LENGTH_M:g} m, not {padding_m:g}"
            return _refusal(text, link=link)
    for link, factor in scene.link_scale.items():
        if not (math.isfinite(factor) and factor > 0.0):
            return _refusal(f"the scale of link {link!r} must be a finite number above 0, not {factor:g}", link=link)
    return None


def _object_refusals(scene_object: SceneObject) -> Iterator[PlanningFailure]:
    subject = f"the object {scene_object.name!r}"
    if not scene_object.shapes:
        yield _refusal(f"{subject} has no shape", object=scene_object.name)
    faults = [pose_fault(scene_object.pose)]
    for shape, pose in scene_object.shapes:
        faults += [shape_fault(shape), pose_fault(pose)]
    for fault in faults:
        if fault is not None:
            yield _refusal(f"{subject} {fault}", object=scene_object.name)


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
