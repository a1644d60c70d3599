from __future__ import annotations

import json

import numpy as np
import pytest
from pydantic import ValidationError

from planners.files.scene_format import SceneFields, scene_fields
from planners.scene import (
    AttachedObject,
    Box,
    Cone,
    Cylinder,
    Mesh,
    Plane,
    Pose,
    Scene,
    SceneObject,
    Sphere,
)

TURNED = Pose((0.1, 0.2, 0.3), (0.0, 0.0, 1.0, 0.0))
SHAPES = {
    "box": Box((0.1, 0.2, 0.3)),
    "sphere": Sphere(0.1),
    "cylinder": Cylinder(radius_m=0.1, height_m=0.3),
    "cone": Cone(radius_m=0.1, height_m=0.3),
    "plane": Plane((0.0, 0.0, 1.0), 0.2),
}


def again(scene: Scene) -> Scene:
    """The scene after its way through JSON."""
    return SceneFields.model_validate(json.loads(json.dumps(scene_fields(scene)))).scene(scene.version)


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_a_shape_is_the_same_when_it_is_read_again(shape) -> None:
    scene = Scene(3, (SceneObject("thing", ((shape, Pose()),), TURNED),))
    assert again(scene) == scene


def test_a_mesh_is_the_same_when_it_is_read_again() -> None:
    mesh = Mesh(np.eye(3) / 3.0, np.array([[0, 1, 2]], dtype=np.int32))
    ((shape, _),) = again(Scene(3, (SceneObject("thing", ((mesh, Pose()),)),))).objects[0].shapes
    np.testing.assert_array_equal(shape.vertices_m, mesh.vertices_m)
    np.testing.assert_array_equal(shape.triangles, mesh.triangles)
    assert shape.triangles.dtype == np.int32


def test_all_the_rest_of_a_scene_is_the_same_when_it_is_read_again() -> None:
    several = SceneObject("several", ((SHAPES["box"], TURNED), (SHAPES["sphere"], Pose())), TURNED)
    held = AttachedObject(SceneObject("held", ((SHAPES["cone"], TURNED),)), "wrist_link", frozenset({"gripper_link"}))
    allowed = {frozenset(("held", "several")): True, frozenset(("base_link", "wrist_link")): False}
    scene = Scene(3, (several,), (held,), allowed, {"wrist_link": 0.01}, {"wrist_link": 1.1})
    assert again(scene) == scene


def test_cylinders_are_given_height_first_as_in_shape_msgs() -> None:
    fields = SceneFields.model_validate({"objects": [{"id": "a", "type": "cylinder", "dimensions": [0.3, 0.1]}]})
    assert fields.scene(1).objects[0].shapes[0][0] == Cylinder(radius_m=0.1, height_m=0.3)


def test_the_pose_of_a_lone_shape_is_the_things() -> None:
    pose = {"position": [0.1, 0.2, 0.3], "orientation": [0.0, 0.0, 1.0, 0.0]}
    fields = SceneFields.model_validate({"objects": [{"id": "a", "type": "sphere", "dimensions": [0.1], "pose": pose}]})
    (thing,) = fields.scene(1).objects
    assert thing.pose == TURNED
    assert thing.shapes[0][1] == Pose()


def test_a_shape_without_its_dimensions_is_refused() -> None:
    with pytest.raises(ValidationError, match="the dimensions of a box are 3 numbers, not 2"):
        SceneFields.model_validate({"objects": [{"id": "a", "type": "box", "dimensions": [0.3, 0.1]}]})
