import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from planners.scene import Box, Pose
from server.errors import RefusedError
from server.moveit.poses import matrix_of
from server.moveit.scene.collision_objects import APPEND, MOVE, REMOVE
from server.moveit.scene.frames import LinkPlaces
from server.moveit.scene.planning_scene import Draft, change_held_object
from tests.helpers.planning_scene import BENT, FORWARD, ROBOT, box, collision_object, draft, held, message, pose

CUP = collision_object(**box("cup", at=pose(0.3)))
BALL = {"type": 2, "dimensions": [0.1]}
LINKS = FORWARD.transforms(BENT)


def changed(*messages, before=(CUP,)):
    changing = draft(*before)
    for each in messages:
        change_held_object(changing, each, "it")
    return changing


def refusal(*messages):
    with pytest.raises(RefusedError) as refused:
        changed(*messages)
    return refused.value.failure


def place_in_root(thing):
    return LINKS[thing.link] @ matrix_of(thing.thing.pose)


def new(name, *, at, frame, **fields):
    return held(name, **{**box(name, at=at, frame=frame), **fields})


def test_add_by_name_alone_takes_the_thing_from_the_world_where_it_is():
    changing = changed(held("cup"))
    assert changing.objects == {}
    np.testing.assert_allclose(place_in_root(changing.attached["cup"])[:3, 3], (0.3, 0.0, 0.0), atol=1e-12)


def test_add_with_shapes_in_the_links_frame_is_exactly_as_told():
    thing = changed(new("tool", at=pose(0.1), frame="gripper_link")).attached["tool"]
    assert (thing.link, thing.thing.pose) == ("gripper_link", Pose((0.1, 0.0, 0.0)))


def test_add_with_shapes_in_another_frame_is_brought_into_the_links():
    thing = changed(new("tool", at=pose(0.1), frame="cup")).attached["tool"]
    np.testing.assert_allclose(place_in_root(thing)[:3, 3], (0.4, 0.0, 0.0), atol=1e-12)


def test_add_with_shapes_replaces_a_thing_of_the_world():
    changing = changed(held("cup", primitives=[BALL], header={"frame_id": "gripper_link"}))
    assert changing.objects == {}
    assert changing.attached["cup"].object.object.shapes[0][0].radius_m == 0.1


def test_touch_links_weight_and_posture_are_kept():
    posture = message("trajectory_msgs/JointTrajectory", joint_names=["gripper"])
    told = {**held("cup", touch_links=("wrist_link", "wrist_link")), "weight": 0.5, "detach_posture": posture}
    thing = changed(told).attached["cup"]
    assert (thing.touch_links, thing.weight, thing.detach_posture) == (("wrist_link",), 0.5, posture)


@pytest.mark.parametrize("touch_links", [("wrist_link",), ("wrist_link", "wrist_link")])
def test_add_of_what_is_held_keeps_the_thing_itself(touch_links):
    told = new("tool", at=pose(0.1), frame="gripper_link") | {"touch_links": list(touch_links)}
    before = changed(told).contents()
    again = Draft(before, LinkPlaces(ROBOT, FORWARD, None))
    change_held_object(again, told, "it")
    assert again.attached["tool"] is before.attached["tool"]


def test_a_thing_that_is_put_down_and_taken_again_is_held_and_stands_nowhere():
    before = changed(held("cup")).contents()
    again = Draft(before, LinkPlaces(ROBOT, FORWARD, BENT))
    change_held_object(again, held("cup", operation=REMOVE), "it")
    change_held_object(again, message("AttachedCollisionObject", **before.attached["cup"].message), "it")
    assert (again.attached, again.objects) == (before.attached, {})


def test_add_by_name_alone_hands_a_thing_from_link_to_link():
    changing = changed(held("cup"), held("cup", "wrist_link"))
    assert changing.attached["cup"].link == "wrist_link"
    np.testing.assert_allclose(place_in_root(changing.attached["cup"])[:3, 3], (0.3, 0.0, 0.0), atol=1e-12)


def test_append_adds_shapes_and_touch_links():
    append = {"operation": APPEND, "primitives": [BALL], "header": {"frame_id": "gripper_link"}}
    tool = new("tool", at=pose(0.1), frame="gripper_link") | {"touch_links": ["lower_arm_link"]}
    changing = changed(tool, held("tool", touch_links=("wrist_link",), **append))
    thing = changing.attached["tool"]
    assert thing.thing.pose == Pose((0.1, 0.0, 0.0))
    assert isinstance(thing.object.object.shapes[0][0], Box)
    np.testing.assert_allclose(thing.thing.shapes[1][1].position_m, (-0.1, 0.0, 0.0), atol=1e-12)
    assert thing.touch_links == ("lower_arm_link", "wrist_link")


def test_remove_puts_a_thing_down_where_it_is_now():
    changing = changed(held("cup"), held("cup", "", operation=REMOVE))
    assert changing.attached == {}
    np.testing.assert_allclose(matrix_of(changing.objects["cup"].pose), matrix_of(Pose((0.3, 0.0, 0.0))), atol=1e-12)


def test_remove_without_name_puts_down_all_that_the_link_holds():
    both = (CUP, collision_object(**box("pen")))
    changing = changed(held("cup"), held("pen", "wrist_link"), held("", "wrist_link", operation=REMOVE), before=both)
    assert (list(changing.attached), list(changing.objects)) == (["cup"], ["pen"])


def test_remove_without_name_and_link_puts_down_everything():
    both = (CUP, collision_object(**box("pen")))
    changing = changed(held("cup"), held("pen", "wrist_link"), held("", "", operation=REMOVE), before=both)
    assert changing.attached == {}


def test_remove_without_name_of_a_link_that_holds_nothing_is_no_error():
    assert changed(held("", operation=REMOVE)).attached == {}


BAD = {
    "unknown link": ([held("cup", "hand")], MoveItErrorCode.INVALID_LINK_NAME, "no link 'hand'"),
    "no link": ([held("cup", "")], MoveItErrorCode.INVALID_LINK_NAME, "no link ''"),
    "from an unknown link": ([held("", "hand", operation=REMOVE)], MoveItErrorCode.INVALID_LINK_NAME, "no link 'hand'"),
    "unknown by name": (
        [held("ghost")],
        MoveItErrorCode.INVALID_OBJECT_NAME,
        "'ghost' has no shape, and there is none",
    ),
    "not held": ([held("cup", operation=REMOVE)], MoveItErrorCode.INVALID_OBJECT_NAME, "no link holds an object 'cup'"),
    "held by another": (
        [held("cup"), held("cup", "wrist_link", operation=REMOVE)],
        MoveItErrorCode.INVALID_LINK_NAME,
        "'cup' is held by gripper_link, not by 'wrist_link'",
    ),
    "moved": ([held("cup", operation=MOVE)], MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "not 3"),
}


@pytest.mark.parametrize(("messages", "code", "words"), BAD.values(), ids=BAD.keys())
def test_what_cannot_be_done_is_refused(messages, code, words):
    failure = refusal(*messages)
    assert failure.code is code
    assert words in failure.message
