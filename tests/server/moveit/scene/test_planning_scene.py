"""Contents of a planning scene, and how messages change them."""

import math

import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from planners.scene import Box, Pose, Sphere
from planners.scene_checks import MAX_SHAPES
from server.moveit.messages import matrix_of
from server.moveit.scene import planning_scene
from server.moveit.scene.allowed_collision_matrix import AllowedCollisionMatrix
from server.moveit.scene.collision_objects import APPEND, MOVE, REMOVE
from server.moveit.scene.frames import LinkTransforms
from tests.helpers.moveit import (
    BENT,
    FORWARD,
    ROBOT,
    assert_refused,
    box,
    collision_object,
    diff,
    draft,
    held,
    message,
    pose,
    rejection,
)

CUP = collision_object(**box("cup", at=pose(0.3)))


OF_ROBOT = AllowedCollisionMatrix.of_robot(ROBOT)
RED = {"r": 1.0, "a": 1.0}
TAKE_CUP = diff(robot_state={"attached_collision_objects": [held("cup")]})
ACM = {"entry_names": ["a", "b"], "entry_values": [{"enabled": [False, True]}, {"enabled": [True, False]}]}


def changed(*messages, before=(CUP,)):
    changing = draft(*before)
    for each in messages:
        planning_scene.apply_planning_scene(changing, each, OF_ROBOT)
    return changing


def test_a_whole_scene_replaces_the_one_before():
    before = diff(
        allowed_collision_matrix=ACM,
        link_padding=[{"link_name": "wrist_link", "padding": 0.1}],
        object_colors=[{"id": "cup", "color": RED}],
    )
    changing = changed(TAKE_CUP, before, message("PlanningScene", world={"collision_objects": [box("new")]}))
    assert (list(changing.objects), changing.attached) == (["new"], {})
    assert (changing.allowed_collisions, changing.padding_m, changing.colors) == (OF_ROBOT, {}, {})


def test_attached_objects_change_before_those_of_the_world():
    """A thing is put down and removed by one message."""
    told = diff(
        robot_state={"attached_collision_objects": [held("cup", operation=1)]},
        world={"collision_objects": [{"id": "cup", "operation": 1}]},
    )
    changing = changed(TAKE_CUP, told)
    assert (changing.attached, changing.objects) == ({}, {})


LISTED = {"is_diff": False, "joint_state": {"name": ["gripper"], "position": [0.0]}}


def test_a_state_that_is_no_diff_detaches_unlisted_objects_unless_it_is_empty():
    for scene, still_held in (
        # A whole scene whose state is a diff keeps them.
        (message("PlanningScene", robot_state={"is_diff": True}), ["cup"]),
        (diff(robot_state={"is_diff": False}), ["cup"]),
        (diff(robot_state={**LISTED, "is_diff": True}), ["cup"]),
        (diff(robot_state=LISTED), []),
        (diff(robot_state={"is_diff": False, "attached_collision_objects": [held("pen", **box("pen"))]}), ["pen"]),
        # Missing fields change nothing, but a state of attached objects does.
        ({"is_diff": True}, ["cup"]),
        ({"is_diff": True, "robot_state": {"is_diff": False, "attached_collision_objects": []}}, []),
    ):
        assert list(changed(TAKE_CUP, scene).attached) == still_held


def test_a_matrix_is_kept_unless_it_is_empty_and_padding_and_scale_unless_they_are_the_default():
    changing = changed(diff(allowed_collision_matrix=ACM), diff())
    assert changing.allowed_collisions.names == ("a", "b")
    padding = [{"link_name": link, "padding": value} for link, value in (("wrist_link", 0.01), ("base_link", 0.0))]
    scale = [{"link_name": link, "scale": value} for link, value in (("wrist_link", 1.1), ("base_link", 1.0))]
    changing = changed(diff(link_padding=padding, link_scale=scale))
    assert (changing.padding_m, changing.scale) == ({"wrist_link": 0.01}, {"wrist_link": 1.1})
    back = diff(link_padding=[{"link_name": "wrist_link", "padding": 0.0}])
    assert changed(diff(link_padding=padding), back).padding_m == {}


CROWD = [box(str(i)) for i in range(MAX_SHAPES + 1)]
MANY = [{"id": str(i), "color": RED} for i in range(planning_scene.MAX_COLORS + 1)]
BAD = [
    ({"world": {"octomap": {"octomap": {"data": [1, 2]}}}}, -22, "world.octomap must be empty"),
    ({"world": {"collision_objects": CROWD}}, -16, f"world brings {MAX_SHAPES + 1} shapes; a scene holds"),
    ({"world": {"collision_objects": [box("a"), {"id": "b"}]}}, -16, "world.collision_objects[1]"),
    (
        {"robot_state": {"attached_collision_objects": [held("ghost")]}},
        -19,
        "robot_state.attached_collision_objects[0].object: the object 'ghost'",
    ),
    ({"link_padding": [{"link_name": "hand"}]}, -18, "link_padding: there is no link 'hand'"),
    ({"link_padding": [{"link_name": "base_link", "padding": -0.1}]}, -16, "at least 0, up to 100, not -0.1"),
    ({"link_scale": [{"link_name": "base_link", "scale": math.nan}]}, -16, "above 0, up to 100, not nan"),
    ({"link_scale": [{"link_name": "base_link", "scale": 0.0}]}, -16, "above 0, up to 100, not 0"),
    ({"object_colors": [{"id": "a", "color": {"r": math.nan}}]}, -16, "object_colors[0].color of 'a'"),
    ({"object_colors": MANY}, -16, f"more than {planning_scene.MAX_COLORS}"),
    ({"allowed_collision_matrix": {"entry_names": ["a"]}}, -16, "allowed_collision_matrix.entry_values"),
]


@pytest.mark.parametrize(("fields", "code", "words"), BAD)
def test_a_bad_field_is_rejected_with_its_path(fields, code, words):
    assert_refused(rejection(changed, diff(**fields)), MoveItErrorCode(code), words)


QUARTER = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
TURNED_CUP = collision_object(**box("cup", at=pose(0.3, turned=QUARTER)))
BALL = {"type": 2, "dimensions": [0.1]}


def after_objects(*messages, before=(TURNED_CUP,)):
    changing = draft(*before)
    for each in messages:
        planning_scene.apply_collision_object(changing, collision_object(**each), "it")
    return changing


def test_an_equal_object_or_pose_keeps_the_present_one():
    before = draft(TURNED_CUP)
    known = before.objects["cup"]
    stamped = {**TURNED_CUP, "header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": "base_link"}}
    for equal in (stamped, collision_object(id="cup", pose=TURNED_CUP["pose"], operation=MOVE)):
        planning_scene.apply_collision_object(before, equal, "it")
        assert before.objects["cup"] is known
    planning_scene.apply_collision_object(before, {**TURNED_CUP, "pose": pose(0.4)}, "it")
    assert before.objects["cup"].pose == Pose((0.4, 0.0, 0.0))


def test_append_adds_shapes_where_the_message_has_them_and_rounds_no_poses():
    append = {"id": "cup", "primitives": [BALL], "primitive_poses": [pose(0.3, 0.2)], "operation": APPEND}
    thing = after_objects(append).objects["cup"]
    assert thing.pose.position_m == (0.3, 0.0, 0.0)
    assert [type(shape) for shape, _ in thing.shapes] == [Box, Sphere]
    placed = matrix_of(thing.pose) @ matrix_of(thing.shapes[1][1])
    np.testing.assert_allclose(placed[:3, 3], (0.3, 0.2, 0.0), atol=1e-12)
    append = {**TURNED_CUP, "primitives": [BALL], "primitive_poses": [pose(0.1)], "operation": APPEND}
    thing = after_objects(append | {"subframe_names": ["rim"], "subframe_poses": [pose(0.2)]}).objects["cup"]
    assert thing.shapes[1][1] == Pose((0.1, 0.0, 0.0))
    assert thing.subframes == {"rim": Pose((0.2, 0.0, 0.0))}


def test_move_needs_no_shapes_and_may_move_those_within_the_object():
    thing = after_objects({"id": "cup", "pose": pose(0.5), "operation": MOVE}).objects["cup"]
    assert (thing.pose, thing.shapes[0][0]) == (Pose((0.5, 0.0, 0.0)), Box((0.05, 0.05, 0.05)))
    two = collision_object(id="two", primitives=[BALL, BALL], pose=pose(1.0))
    move = {"id": "two", "pose": pose(2.0), "primitive_poses": [pose(0.1), pose(0.2)], "operation": MOVE}
    thing = after_objects(move, before=(two,)).objects["two"]
    assert [at.position_m[0] for _, at in thing.shapes] == [0.1, 0.2]
    # The pose of a single shape moves the object.
    thing = after_objects({"id": "cup", "primitive_poses": [pose(0.7)], "operation": MOVE}).objects["cup"]
    assert (thing.pose, thing.shapes[0][1]) == (Pose((0.7, 0.0, 0.0)), Pose())


def test_an_object_that_cannot_be_used_is_refused():
    for asked, words in (
        ({"id": "ghost", "operation": MOVE}, "'ghost'"),
        ({"id": "ghost", "operation": REMOVE}, "'ghost'"),
        ({"id": "cup", "primitive_poses": [pose()] * 2, "operation": MOVE}, "poses of 2 shapes; 'cup' has 1"),
        ({**box("x"), "operation": 7}, "must be one of 0 (ADD), 1 (REMOVE), 2 (APPEND), 3 (MOVE), not 7"),
        (box("x", frame="nowhere"), "no frame 'nowhere'"),
        ({"id": "cup", "pose": pose(math.nan), "operation": MOVE}, "it.pose.position.x"),
    ):
        failure = rejection(after_objects, asked)
        assert words in failure.message
        assert (failure.code is MoveItErrorCode.INVALID_OBJECT_NAME) is (words == "'ghost'")


LINKS = FORWARD.transforms(BENT)


def after_attached(*messages, before=(CUP,)):
    changing = draft(*before)
    for each in messages:
        planning_scene.apply_attached_object(changing, each, "it")
    return changing


def place_in_root(thing):
    return LINKS[thing.link] @ matrix_of(thing.collision_object.pose)


def new(name, *, at, frame, **fields):
    return held(name, **{**box(name, at=at, frame=frame), **fields})


def test_attach_takes_objects_from_where_they_are_and_detach_leaves_them_where_they_are_now():
    changing = after_attached(held("cup"))
    assert changing.objects == {}
    np.testing.assert_allclose(place_in_root(changing.attached["cup"])[:3, 3], (0.3, 0.0, 0.0), atol=1e-12)
    thing = after_attached(new("tool", at=pose(0.1), frame="cup")).attached["tool"]
    np.testing.assert_allclose(place_in_root(thing)[:3, 3], (0.4, 0.0, 0.0), atol=1e-12)
    changing = after_attached(held("cup"), held("cup", "", operation=REMOVE))
    assert changing.attached == {}
    np.testing.assert_allclose(matrix_of(changing.objects["cup"].pose), matrix_of(Pose((0.3, 0.0, 0.0))), atol=1e-12)
    taken, all_of_the_wrist = (held("cup"), held("pen", "wrist_link")), held("", "wrist_link", operation=REMOVE)
    changing = after_attached(*taken, all_of_the_wrist, before=(CUP, collision_object(**box("pen"))))
    assert (list(changing.attached), list(changing.objects)) == (["cup"], ["pen"])


def test_touch_links_weight_and_posture_are_kept_and_append_adds_shapes_and_touch_links():
    posture = message("trajectory_msgs/JointTrajectory", joint_names=["gripper"])
    told = {**held("cup", touch_links=("wrist_link", "wrist_link")), "weight": 0.5, "detach_posture": posture}
    thing = after_attached(told).attached["cup"]
    assert (thing.touch_links, thing.weight, thing.detach_posture) == (("wrist_link",), 0.5, posture)
    append = {"operation": APPEND, "primitives": [BALL], "header": {"frame_id": "gripper_link"}}
    tool = new("tool", at=pose(0.1), frame="gripper_link") | {"touch_links": ["lower_arm_link"]}
    thing = after_attached(tool, held("tool", touch_links=("wrist_link",), **append)).attached["tool"]
    assert thing.collision_object.pose == Pose((0.1, 0.0, 0.0))
    assert isinstance(thing.attached_object.object.shapes[0][0], Box)
    np.testing.assert_allclose(thing.collision_object.shapes[1][1].position_m, (-0.1, 0.0, 0.0), atol=1e-12)
    assert thing.touch_links == ("lower_arm_link", "wrist_link")


@pytest.mark.parametrize("touch_links", [("wrist_link",), ("wrist_link", "wrist_link")])
def test_attach_of_an_equal_object_keeps_the_present_one(touch_links):
    told = new("tool", at=pose(0.1), frame="gripper_link") | {"touch_links": list(touch_links)}
    before = after_attached(told).contents()
    again = planning_scene.SceneDraft(before, LinkTransforms(ROBOT, FORWARD, None))
    planning_scene.apply_attached_object(again, told, "it")
    assert again.attached["tool"] is before.attached["tool"]
    planning_scene.apply_attached_object(again, {**told, "weight": 0.5}, "it")
    assert again.attached["tool"].weight == 0.5


LINK, OBJECT = MoveItErrorCode.INVALID_LINK_NAME, MoveItErrorCode.INVALID_OBJECT_NAME
FROM_ANOTHER = held("cup", "wrist_link", operation=REMOVE)
BAD_ATTACHED = [
    ([held("cup", "hand")], LINK, "no link 'hand'"),
    ([held("cup", "")], LINK, "no link ''"),
    ([held("", "hand", operation=REMOVE)], LINK, "no link 'hand'"),
    ([held("ghost")], OBJECT, "'ghost' has no shape, and the scene has no object"),
    ([held("cup", operation=REMOVE)], OBJECT, "no link holds an object 'cup'"),
    ([held("cup"), FROM_ANOTHER], LINK, "'cup' is held by gripper_link, not by 'wrist_link'"),
    ([held("cup", operation=MOVE)], MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "not 3"),
]


@pytest.mark.parametrize(("messages", "code", "words"), BAD_ATTACHED)
def test_an_attached_object_that_cannot_be_used_is_refused(messages, code, words):
    assert_refused(rejection(after_attached, *messages), code, words)
