"""Collision objects as moveit_msgs/CollisionObject describes them."""

from __future__ import annotations

import math

import pytest

from planners.scene import Box, Plane, Pose, Sphere
from server.moveit.scene.collision_objects import (
    MAX_SUBFRAMES,
    AttachedCollisionObject,
    read_collision_object,
)
from tests.helpers.moveit import box, collision_object, pose, rejection

BALL = {"type": 2, "dimensions": [0.1]}
QUARTER = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
RICH = collision_object(
    id="rack",
    header={"frame_id": "base_link"},
    pose=pose(1.0, 2.0, 3.0, turned=QUARTER),
    type={"key": "furniture", "db": "{}"},
    primitives=[{"type": 1, "dimensions": [1.0, 2.0, 3.0]}, BALL],
    primitive_poses=[pose(0.1), pose(0.2, turned=QUARTER)],
    planes=[{"coef": [0.0, 0.0, 1.0, 0.5]}],
    plane_poses=[pose(0.0, 0.0, 0.3)],
    subframe_names=["hook"],
    subframe_poses=[pose(0.0, 0.4)],
)


def test_an_object_is_written_as_it_was_read():
    assert read_collision_object(RICH, "base_link", "it").message == RICH


def test_shapes_are_in_the_objects_frame_in_moveits_order():
    thing = read_collision_object(RICH, "base_link", "it")
    assert [type(shape) for shape, _ in thing.shapes] == [Box, Sphere, Plane]
    assert [at.position_m[0] for _, at in thing.shapes] == [0.1, 0.2, 0.0]
    assert thing.scene_object.pose.position_m == (1.0, 2.0, 3.0)
    assert thing.subframes == {"hook": Pose((0.0, 0.4, 0.0))}


def test_an_object_without_a_pose_gets_that_of_its_single_shape():
    thing = read_collision_object(collision_object(**box("b"), primitive_poses=[pose(0.3)]), "", "it")
    assert thing.pose == Pose((0.3, 0.0, 0.0))
    assert thing.shapes[0][1] == Pose()


def test_a_repeated_message_equals_its_object_whatever_its_stamp():
    thing = read_collision_object(RICH, "base_link", "it")
    header = {"stamp": {"sec": 9, "nanosec": 9}, "frame_id": "base_link"}
    assert thing.equals_message({**RICH, "header": header})
    assert not thing.equals_message({**RICH, "pose": pose(1.0)})


def test_two_attached_objects_are_equal_unless_a_field_differs():
    thing, posture = read_collision_object(RICH, "gripper_link", "it"), {}
    held = AttachedCollisionObject(thing, ("wrist_link",), posture, 0.25)
    assert held.equals(
        AttachedCollisionObject(read_collision_object(RICH, "gripper_link", "it"), ("wrist_link",), posture, 0.25)
    )
    others = [((), posture, 0.25), (("wrist_link",), {"points": []}, 0.25), (("wrist_link",), posture, 0.5)]
    assert not any(held.equals(AttachedCollisionObject(thing, *other)) for other in others)


BAD = {
    "no shape": ({"primitives": []}, "has no shape"),
    "a pose of NaN": ({"pose": pose(math.nan)}, "it.pose.position.x must be a finite number, not nan"),
    "beyond the horizon": ({"pose": pose(1e6)}, "beyond 100 m"),
    "a shape's pose of NaN": ({"primitive_poses": [pose(0.0, math.inf)]}, "it.primitive_poses[0].position.y"),
    "more poses than shapes": (
        {"primitive_poses": [pose(), pose()]},
        "it.primitive_poses has 2 entries, primitives only 1",
    ),
    "poses of no meshes": ({"mesh_poses": [pose()]}, "it.mesh_poses has 1 entries, meshes only 0"),
    "a bad shape": ({"primitives": [{"type": 2, "dimensions": [0.0]}]}, "it.primitives[0] is a sphere"),
    "subframes without poses": ({"subframe_names": ["a"]}, "subframe_names has 1 entries, subframe_poses 0"),
    "subframes without name": ({"subframe_names": [""], "subframe_poses": [pose()]}, "it.subframe_names[0] is ''"),
    "subframes twice": ({"subframe_names": ["a", "a"], "subframe_poses": [pose()] * 2}, "it.subframe_names[1] is 'a'"),
    "a subframe of NaN": ({"subframe_names": ["a"], "subframe_poses": [pose(math.nan)]}, "it.subframe_poses[0]"),
    "too many subframes": (
        {"subframe_names": ["a"] * (MAX_SUBFRAMES + 1), "subframe_poses": [pose()] * (MAX_SUBFRAMES + 1)},
        f"more than {MAX_SUBFRAMES}",
    ),
}


@pytest.mark.parametrize(("fields", "words"), BAD.values(), ids=BAD.keys())
def test_a_bad_value_is_rejected_with_object_and_field(fields, words):
    refusal = rejection(read_collision_object, collision_object(**{**box("odd one"), **fields}), "", "it")
    assert words in refusal.message
    assert "'odd one'" in refusal.message
    assert refusal.details["object"] == "odd one"
