import math

import numpy as np

from planners.problem import MoveItErrorCode
from planners.scene import AttachedObject, Box, Cone, Cylinder, Mesh, Plane, Pose, SceneObject, Sphere
from planners.scene_checks import MAX_SCENE_TRIANGLES, MAX_SHAPES, MAX_TRIANGLES, check_scene, check_whole
from tests.planners.scenes import CORNERS_M, FACES, scene

LINKS = ("base_link", "gripper_link")
CUBE = Box((0.1, 0.1, 0.1))
ORIGIN = Pose()
NAN, INF = math.nan, math.inf


def thing(shape=CUBE, name="thing", pose=ORIGIN, at=ORIGIN):
    return SceneObject(name, ((shape, at),), pose)


BAD_SHAPES = (
    *(Box((0.1, 0.1, 0.0)), Box((0.1, -0.1, 0.1)), Box((0.1, NAN, 0.1)), Box((0.1, 0.1, INF))),
    # A point, a sphere as large as a town, and so on.
    *(Sphere(0.0), Sphere(1000.0), Cylinder(0.1, 0.0), Cone(NAN, 0.1)),
    *(Plane((0.0, 0.0, 0.0), 0.0), Plane((0.0, 0.0, NAN), 0.0), Plane((0.0, 0.0, 1.0), INF)),
    # No triangles, or too many; vertices that are absent; lines for triangles, and other shapes of the arrays.
    *(Mesh(CORNERS_M, FACES[:0]), Mesh(CORNERS_M, np.tile(FACES, (MAX_TRIANGLES // 4 + 1, 1)))),
    *(Mesh(CORNERS_M * NAN, FACES), Mesh(CORNERS_M, FACES + 1), Mesh(CORNERS_M, FACES - 1)),
    *(Mesh(CORNERS_M, np.zeros_like(FACES)), Mesh(CORNERS_M, FACES[:, :2]), Mesh(CORNERS_M[:, :2], FACES)),
)


def test_a_bad_shape_or_pose_is_refused_by_the_name_of_its_object():
    bad_poses = Pose((NAN, 0.0, 0.0)), Pose((0.0, 1e6, 0.0)), Pose(orientation=(0.0,) * 4), Pose(orientation=(NAN,) * 4)
    for shape in BAD_SHAPES:
        refusal = check_scene(scene(thing(), thing(shape, "odd one")), LINKS)
        assert refusal.code == MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, shape
        assert "odd one" in refusal.message
        assert refusal.details["object"] == "odd one"
    for pose in bad_poses:
        for parts in ({"pose": pose}, {"at": pose}):
            assert check_scene(scene(thing(**parts)), LINKS).code == MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, parts


def test_names_that_are_empty_or_taken_and_links_that_the_robot_does_not_have_are_refused():
    for name in ("", "thing", "gripper_link"):
        attached = AttachedObject(thing(name=name), "gripper_link")
        for crowd in (scene(thing(), thing(name=name)), scene(thing(), attached=(attached,))):
            assert check_scene(crowd, LINKS).code == MoveItErrorCode.INVALID_OBJECT_NAME, name
    touching = AttachedObject(thing(), "gripper_link", frozenset({"hand"}))
    for parts in (
        *({"attached": (AttachedObject(thing(), "hand"),)}, {"attached": (touching,)}),
        *({"link_padding_m": {"hand": 0.01}}, {"link_scale": {"hand": 1.1}}),
    ):
        refusal = check_scene(scene(**parts), LINKS)
        assert refusal.code == MoveItErrorCode.INVALID_LINK_NAME
        assert "'hand'" in refusal.message


def test_a_padding_or_scale_that_is_none_and_an_object_without_shapes_are_refused():
    for value in (-0.001, NAN, INF):
        assert check_scene(scene(link_padding_m={"gripper_link": value}), LINKS) is not None
        assert check_scene(scene(link_scale={"gripper_link": value}), LINKS) is not None
    assert check_scene(scene(link_padding_m={"gripper_link": 0.0}), LINKS) is None
    assert check_scene(scene(link_scale={"gripper_link": 0.0}), LINKS) is not None
    assert "no shape" in check_scene(scene(SceneObject("ghost", ())), LINKS).message


def test_more_shapes_or_triangles_in_all_than_the_limit_are_refused_with_both_figures():
    crowd = SceneObject("crowd", ((CUBE, Pose()),) * MAX_SHAPES)
    assert check_scene(scene(crowd), LINKS) is None
    assert check_scene(scene(crowd, thing()), LINKS).details == {"shapes": MAX_SHAPES + 1, "limit": MAX_SHAPES}
    large = Mesh(CORNERS_M, np.tile(FACES, (MAX_TRIANGLES // len(FACES), 1)))
    fits = MAX_SCENE_TRIANGLES // MAX_TRIANGLES
    meshes = [thing(large, str(number)) for number in range(fits + 1)]
    assert check_whole(scene(*meshes[:fits]), LINKS) is None
    refusal = check_whole(scene(*meshes), LINKS)
    assert refusal.details == {"triangles": (fits + 1) * MAX_TRIANGLES, "limit": MAX_SCENE_TRIANGLES}
