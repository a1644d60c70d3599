import math

import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from planners.scene import Box, Pose, Sphere
from server.errors import RefusedError
from server.moveit.poses import matrix_of
from server.moveit.scene.collision_objects import ADD, APPEND, MOVE, REMOVE
from server.moveit.scene.planning_scene import change_object
from tests.helpers.planning_scene import BENT, FORWARD, box, collision_object, draft, pose

QUARTER = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
CUP = collision_object(**box("cup", at=pose(0.3, turned=QUARTER)))
BALL = {"type": 2, "dimensions": [0.1]}


def changed(*messages, before=(CUP,)):
    changing = draft(*before)
    for message in messages:
        change_object(changing, collision_object(**message), "it")
    return changing


def refusal(*messages):
    with pytest.raises(RefusedError) as refused:
        changed(*messages)
    return refused.value.failure


def test_add_puts_a_thing_where_its_frame_says():
    lid = changed(box("lid", at=pose(0.1), frame="cup")).objects["lid"]
    np.testing.assert_allclose(lid.pose.position_m, (0.3, 0.1, 0.0), atol=1e-12)


def test_add_in_the_frame_of_a_link_stays_where_the_link_is_now():
    thing = changed(box("lid", frame="gripper_link")).objects["lid"]
    np.testing.assert_allclose(matrix_of(thing.pose), FORWARD.transforms(BENT)["gripper_link"], atol=1e-12)


def test_add_replaces_a_thing_of_the_same_name():
    thing = changed({"id": "cup", "primitives": [BALL]}).objects["cup"]
    assert thing.shapes == ((Sphere(0.1), Pose()),)


def test_add_of_what_is_known_keeps_the_thing_itself():
    before = draft(CUP)
    known = before.objects["cup"]
    change_object(before, {**CUP, "header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": "base_link"}}, "it")
    assert before.objects["cup"] is known


def test_append_adds_shapes_where_the_message_has_them():
    append = {"id": "cup", "primitives": [BALL], "primitive_poses": [pose(0.3, 0.2)], "operation": APPEND}
    thing = changed(append).objects["cup"]
    assert thing.pose.position_m == (0.3, 0.0, 0.0)
    assert [type(shape) for shape, _ in thing.shapes] == [Box, Sphere]
    np.testing.assert_allclose(
        (matrix_of(thing.pose) @ matrix_of(thing.shapes[1][1]))[:3, 3], (0.3, 0.2, 0.0), atol=1e-12
    )


def test_append_in_the_things_own_pose_takes_poses_exactly_as_told():
    append = {**CUP, "primitives": [BALL], "primitive_poses": [pose(0.1)], "operation": APPEND}
    thing = changed(append | {"subframe_names": ["rim"], "subframe_poses": [pose(0.2)]}).objects["cup"]
    assert thing.shapes[1][1] == Pose((0.1, 0.0, 0.0))
    assert thing.subframes == {"rim": Pose((0.2, 0.0, 0.0))}


def test_append_keeps_moveits_order_of_kinds():
    plane = {"id": "cup", "planes": [{"coef": [0.0, 0.0, 1.0, 0.0]}], "operation": APPEND}
    ball = {"id": "cup", "primitives": [BALL], "operation": APPEND}
    told = changed(plane, ball).objects["cup"].message
    assert [len(told[field]) for field in ("primitives", "primitive_poses", "planes", "plane_poses")] == [2, 2, 1, 1]
    assert told["primitives"][1]["type"] == 2


def test_append_to_nothing_adds():
    assert "new" in changed(box("new", operation=APPEND)).objects


def test_append_changes_the_type_only_when_it_tells_one():
    typed = {**CUP, "type": {"key": "mug", "db": ""}}
    assert changed({**CUP, "operation": APPEND}, before=(typed,)).objects["cup"].type["key"] == "mug"
    assert changed({**typed, "operation": APPEND}).objects["cup"].type["key"] == "mug"


def test_move_needs_no_shapes_and_keeps_all_but_the_pose():
    thing = changed({"id": "cup", "pose": pose(0.5), "operation": MOVE}).objects["cup"]
    assert thing.pose == Pose((0.5, 0.0, 0.0))
    assert thing.shapes[0][0] == Box((0.05, 0.05, 0.05))


def test_move_to_where_it_is_keeps_the_thing_itself():
    before = draft(CUP)
    known = before.objects["cup"]
    change_object(before, collision_object(id="cup", pose=CUP["pose"], operation=MOVE), "it")
    assert before.objects["cup"] is known


def test_move_may_move_the_shapes_within_the_thing():
    two = collision_object(id="two", primitives=[BALL, BALL], pose=pose(1.0))
    move = {"id": "two", "pose": pose(2.0), "primitive_poses": [pose(0.1), pose(0.2)], "operation": MOVE}
    thing = changed(move, before=(two,)).objects["two"]
    assert [at.position_m[0] for _, at in thing.shapes] == [0.1, 0.2]


def test_move_by_the_pose_of_a_single_shape_moves_the_thing_as_when_it_was_added():
    thing = changed({"id": "cup", "primitive_poses": [pose(0.7)], "operation": MOVE}).objects["cup"]
    assert (thing.pose, thing.shapes[0][1]) == (Pose((0.7, 0.0, 0.0)), Pose())


def test_remove_takes_a_thing_its_colour_and_its_entries():
    changing = draft(CUP)
    changing.colors["cup"] = {}
    change_object(changing, collision_object(id="cup", operation=REMOVE), "it")
    assert (changing.objects, changing.colors) == ({}, {})


def test_remove_without_name_takes_everything():
    assert changed({"operation": REMOVE}, before=(CUP, collision_object(**box("other")))).objects == {}


@pytest.mark.parametrize("operation", [MOVE, REMOVE])
def test_what_is_not_there_cannot_be_moved_or_removed(operation):
    failure = refusal({"id": "ghost", "operation": operation})
    assert failure.code is MoveItErrorCode.INVALID_OBJECT_NAME
    assert "'ghost'" in failure.message


@pytest.mark.parametrize("operation", [ADD, APPEND])
def test_a_thing_without_shapes_is_refused(operation):
    assert "'x' has no shape" in refusal({"id": "x", "operation": operation}).message


def test_move_must_give_as_many_poses_as_there_are_shapes():
    failure = refusal({"id": "cup", "primitive_poses": [pose()] * 2, "operation": MOVE})
    assert "poses of 2 shapes; 'cup' has 1" in failure.message


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ({**box("x"), "operation": 7}, "must be one of 0 (ADD), 1 (REMOVE), 2 (APPEND), 3 (MOVE), not 7"),
        (box("x", frame="nowhere"), "no frame 'nowhere'"),
        ({"id": "cup", "pose": pose(math.nan), "operation": MOVE}, "it.pose.position.x"),
    ],
)
def test_what_cannot_be_done_is_refused(message, words):
    assert words in refusal(message).message
