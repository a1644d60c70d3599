"""Scenes in problem files: what the ``objects``, ``attached`` and contact fields mean, read and written.

Sizes and names are taken as they come; whether a scene can be used is for the collision model to say.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, model_validator

from planners import scene

Point = tuple[float, float, float]
Kind = Literal["box", "sphere", "cylinder", "cone", "plane", "mesh"]

# How many numbers the dimensions of a shape are; cylinders and cones as shape_msgs/SolidPrimitive, height first.
DIMENSIONS: Mapping[str, int] = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2, "plane": 4, "mesh": 0}

_SHAPE_OF: Mapping[str, Callable[..., scene.Shape]] = {
    "box": lambda x, y, z: scene.Box((x, y, z)),
    "sphere": scene.Sphere,
    "cylinder": lambda height, radius: scene.Cylinder(radius, height),
    "cone": lambda height, radius: scene.Cone(radius, height),
    "plane": lambda x, y, z, offset: scene.Plane((x, y, z), offset),
}


class PoseFields(BaseModel):
    """A pose: ``position`` [m], ``orientation`` as a quaternion x, y, z, w."""

    position: Point = (0.0, 0.0, 0.0)
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    def pose(self) -> scene.Pose:
        """The pose meant."""
        return scene.Pose(self.position, self.orientation)


class ShapeFields(BaseModel):
    """A shape: ``type`` with ``dimensions`` [m], or a mesh with ``vertices`` [m] and ``triangles``."""

    type: Kind
    dimensions: list[float] = []
    vertices: list[Point] = []
    triangles: list[tuple[int, int, int]] = []
    pose: PoseFields = PoseFields()

    @model_validator(mode="after")
    def _has_its_dimensions(self) -> ShapeFields:
        expected = DIMENSIONS[self.type]
        if self.type != "mesh" and len(self.dimensions) != expected:
            raise ValueError(f"the dimensions of a {self.type} are {expected} numbers, not {len(self.dimensions)}")
        return self

    def shape(self) -> scene.Shape:
        """The shape meant, without its pose."""
        if self.type == "mesh":
            vertices_m = np.array(self.vertices, dtype=np.float64).reshape(-1, 3)
            return scene.Mesh(vertices_m, np.array(self.triangles, dtype=np.int32).reshape(-1, 3))
        return _SHAPE_OF[self.type](*self.dimensions)


class ObjectFields(BaseModel):
    """A thing: of one shape, given beside its ``id``, or of several in ``shapes``."""

    id: str
    pose: PoseFields = PoseFields()
    shapes: list[ShapeFields]

    @model_validator(mode="before")
    @classmethod
    def _one_shape_is_given_beside_the_name(cls, fields: Any) -> Any:
        if not isinstance(fields, dict) or "shapes" in fields:
            return fields
        return {**fields, "shapes": [{name: value for name, value in fields.items() if name != "pose"}]}

    def object(self) -> scene.SceneObject:
        """The thing meant."""
        shapes = tuple((fields.shape(), fields.pose.pose()) for fields in self.shapes)
        return scene.SceneObject(self.id, shapes, self.pose.pose())


class AttachedFields(ObjectFields):
    """A thing held by ``link``, its pose in the link's frame."""

    link: str
    touch_links: list[str] = []


class SceneFields(BaseModel):
    """What stands around, what is held, and what may touch."""

    objects: list[ObjectFields] = []
    attached: list[AttachedFields] = []
    allowed_contacts: list[tuple[str, str, bool]] = []
    link_padding: dict[str, float] = {}
    link_scale: dict[str, float] = {}

    def scene(self, version: int) -> scene.Scene:
        """The scene meant.

        Args:
            version: a number that no other scene has.
        """
        return scene.Scene(
            version,
            tuple(fields.object() for fields in self.objects),
            tuple(
                scene.AttachedObject(fields.object(), fields.link, frozenset(fields.touch_links))
                for fields in self.attached
            ),
            {frozenset((first, second)): allowed for first, second, allowed in self.allowed_contacts},
            self.link_padding,
            self.link_scale,
        )


def scene_fields(surroundings: scene.Scene) -> dict[str, Any]:
    """A scene as fields of a problem file."""
    held = surroundings.attached
    return {
        "objects": [_object_fields(thing) for thing in surroundings.objects],
        "attached": [
            {**_object_fields(each.object), "link": each.link, "touch_links": sorted(each.touch_links)} for each in held
        ],
        "allowed_contacts": [[min(pair), max(pair), allowed] for pair, allowed in surroundings.allowed.items() if pair],
        "link_padding": dict(surroundings.link_padding_m),
        "link_scale": dict(surroundings.link_scale),
    }


def _object_fields(thing: scene.SceneObject) -> dict[str, Any]:
    name = {"id": thing.name, "pose": _pose_fields(thing.pose)}
    if len(thing.shapes) == 1 and thing.shapes[0][1] == scene.Pose():
        return {**_shape_fields(thing.shapes[0][0]), **name}
    return {**name, "shapes": [{**_shape_fields(shape), "pose": _pose_fields(pose)} for shape, pose in thing.shapes]}


def _pose_fields(pose: scene.Pose) -> dict[str, Any]:
    return {"position": list(pose.position_m), "orientation": list(pose.orientation)}


def _shape_fields(shape: scene.Shape) -> dict[str, Any]:
    match shape:
        case scene.Box(size_m):
            return {"type": "box", "dimensions": list(size_m)}
        case scene.Sphere(radius_m):
            return {"type": "sphere", "dimensions": [radius_m]}
        case scene.Cylinder(radius_m, height_m):
            return {"type": "cylinder", "dimensions": [height_m, radius_m]}
        case scene.Cone(radius_m, height_m):
            return {"type": "cone", "dimensions": [height_m, radius_m]}
        case scene.Plane(normal, offset_m):
            return {"type": "plane", "dimensions": [*normal, offset_m]}
        case scene.Mesh(vertices_m, triangles):
            return {"type": "mesh", "vertices": vertices_m.tolist(), "triangles": triangles.tolist()}
