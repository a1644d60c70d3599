import math

import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from planners.scene import AttachedObject, Box, Cone, Cylinder, Mesh, Plane, Pose, Scene, SceneObject, Sphere
from planners.scene_checks import MAX_SCENE_TRIANGLES, MAX_SHAPES, MAX_TRIANGLES, check_scene, check_whole

LINKS = ("base_link", "gripper_link")
CUBE = Box((0.1, 0.1, 0.1))
ORIGIN = Pose()
CORNERS = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
FACES = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], dtype=np.int32)


def thing(shape=CUBE, name="thing", pose=ORIGIN, at=ORIGIN):
    return SceneObject(name, ((shape, at),), pose)


def scene(*objects, **parts):
    return Scene(1, objects, **parts)


BAD_SHAPES = {
    "a box without height": Box((0.1, 0.1, 0.0)),
    "a box inside out": Box((0.1, -0.1, 0.1)),
    "a box of NaN": Box((0.1, math.nan, 0.1)),
    "an endless box": Box((0.1, 0.1, math.inf)),
    "a point": Sphere(0.0),
    "a sphere as large as a town": Sphere(1000.0),
    "a flat cylinder": Cylinder(0.1, 0.0),
    "a cone of NaN": Cone(math.nan, 0.1),
    "a plane without direction": Plane((0.0, 0.0, 0.0), 0.0),
    "a plane of NaN": Plane((0.0, 0.0, math.nan), 0.0),
    "a plane nowhere": Plane((0.0, 0.0, 1.0), math.inf),
    "a mesh without triangles": Mesh(CORNERS, FACES[:0]),
    "a mesh of too many": Mesh(CORNERS, np.tile(FACES, (MAX_TRIANGLES // 4 + 1, 1))),
    "a mesh of NaN": Mesh(CORNERS * math.nan, FACES),
    "a mesh that names absent vertices": Mesh(CORNERS, FACES + 1),
    "a mesh that names negative vertices": Mesh(CORNERS, FACES - 1),
    "a mesh of lines": Mesh(CORNERS, np.zeros_like(FACES)),
    "a mesh of pairs": Mesh(CORNERS, FACES[:, :2]),
    "a mesh in a plane of two axes": Mesh(CORNERS[:, :2], FACES),
}


@pytest.mark.parametrize("shape", BAD_SHAPES.values(), ids=BAD_SHAPES.keys())
def test_a_bad_shape_is_refused_by_the_name_of_its_object(shape):
    refusal = check_scene(scene(thing(), thing(shape, "odd one")), LINKS)
    assert refusal.code == MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert "odd one" in refusal.message
    assert refusal.details["object"] == "odd one"


BAD_POSES = [
    Pose((math.nan, 0.0, 0.0)),
    Pose((0.0, 1e6, 0.0)),
    Pose(orientation=(0.0,) * 4),
    Pose(orientation=(math.nan,) * 4),
]


@pytest.mark.parametrize("pose", BAD_POSES)
@pytest.mark.parametrize("field", ["pose", "at"])
def test_a_pose_that_is_none_is_refused(pose, field):
    refusal = check_scene(scene(thing(**{field: pose})), LINKS)
    assert refusal.code == MoveItErrorCode.INVALID_GOAL_CONSTRAINTS


@pytest.mark.parametrize("name", ["", "thing", "gripper_link"])
def test_names_that_are_empty_or_taken_are_refused(name):
    for crowd in (
        scene(thing(), thing(name=name)),
        scene(thing(), attached=(AttachedObject(thing(name=name), "gripper_link"),)),
    ):
        assert check_scene(crowd, LINKS).code == MoveItErrorCode.INVALID_OBJECT_NAME


@pytest.mark.parametrize(
    "parts",
    [
        {"attached": (AttachedObject(thing(), "hand"),)},
        {"attached": (AttachedObject(thing(), "gripper_link", frozenset({"hand"})),)},
        {"link_padding_m": {"hand": 0.01}},
        {"link_scale": {"hand": 1.1}},
    ],
)
def test_a_link_that_the_robot_does_not_have_is_refused(parts):
    refusal = check_scene(scene(**parts), LINKS)
    assert refusal.code == MoveItErrorCode.INVALID_LINK_NAME
    assert "'hand'" in refusal.message


def test_a_padding_or_scale_that_is_none_and_an_object_without_shapes_are_refused():
    for value in (-0.001, math.nan, math.inf):
        assert check_scene(scene(link_padding_m={"gripper_link": value}), LINKS) is not None
        assert check_scene(scene(link_scale={"gripper_link": value}), LINKS) is not None
    assert check_scene(scene(link_padding_m={"gripper_link": 0.0}), LINKS) is None
    assert check_scene(scene(link_scale={"gripper_link": 0.0}), LINKS) is not None
    assert "no shape" in check_scene(scene(SceneObject("ghost", ())), LINKS).message


def test_more_shapes_than_the_limit_are_refused_with_both_figures():
    crowd = [SceneObject("crowd", ((CUBE, Pose()),) * MAX_SHAPES), thing()]
    assert check_scene(scene(crowd[0]), LINKS) is None
    assert check_scene(scene(*crowd), LINKS).details == {"shapes": MAX_SHAPES + 1, "limit": MAX_SHAPES}


def test_more_triangles_in_all_than_the_limit_are_refused_with_both_figures():
    large = Mesh(CORNERS, np.tile(FACES, (MAX_TRIANGLES // len(FACES), 1)))
    fits = MAX_SCENE_TRIANGLES // MAX_TRIANGLES
    crowd = [thing(large, str(number)) for number in range(fits + 1)]
    assert check_whole(scene(*crowd[:fits]), LINKS) is None
    refusal = check_whole(scene(*crowd), LINKS)
    assert refusal.details == {"triangles": (fits + 1) * MAX_TRIANGLES, "limit": MAX_SCENE_TRIANGLES}
