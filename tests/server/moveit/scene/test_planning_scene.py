"""Contents of a planning scene, and how messages change them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from planners.scene import Box, Pose, Sphere
from planners.scene_checks import MAX_SHAPES
from server.moveit.poses import matrix_of
from server.moveit.scene.allowed_collision_matrix import AllowedCollisionMatrix
from server.moveit.scene.collision_objects import ADD, APPEND, MOVE, REMOVE, read_collision_object
from server.moveit.scene.frames import LinkTransforms
from server.moveit.scene.planning_scene import (
    MAX_COLORS,
    SceneDraft,
    apply_attached_object,
    apply_collision_object,
    apply_planning_scene,
    apply_world,
)
from tests.helpers.moveit import (
    BENT,
    FORWARD,
    ROBOT,
    box,
    collision_object,
    diff,
    draft,
    held,
    message,
    pose,
    rejection,
    scene_state,
)

CUP = collision_object(**box("cup", at=pose(0.3)))


def test_a_draft_does_not_change_its_original():
    state = scene_state(CUP)
    before = state.contents
    changing = SceneDraft(before, draft().links)
    changing.objects.clear()
    changing.colors["cup"] = {}
    assert list(before.objects) == ["cup"]
    assert before.colors == {}


def test_an_object_is_transformed_from_its_frame():
    changing = draft(CUP)
    placed = changing.in_planning_frame(
        read_collision_object(collision_object(**box("lid", at=pose(0.0, 0.0, 0.1))), "cup", "it")
    )
    assert (placed.frame, placed.pose) == ("base_link", Pose((0.3, 0.0, 0.1)))


def test_an_object_in_an_unknown_frame_is_rejected_with_its_name():
    refusal = rejection(
        draft().in_planning_frame, read_collision_object(collision_object(**box("lid")), "nowhere", "it")
    )
    failure = refusal
    assert failure.code is MoveItErrorCode.FRAME_TRANSFORM_FAILURE
    assert (failure.details["object"], failure.details["frame"]) == ("lid", "nowhere")


def test_scenes_that_differ_in_colour_alone_look_alike():
    contents, changing = scene_state(CUP).contents, draft(CUP)
    changing.objects = dict(contents.objects)
    changing.colors["cup"] = {"r": 1.0}
    assert changing.contents().looks_same(contents)
    assert changing.contents() != contents


@pytest.mark.parametrize("part", ["objects", "padding_m", "scale"])
def test_scenes_that_differ_for_planners_do_not_look_alike(part):
    contents, changing = scene_state(CUP).contents, draft()
    changing.objects = dict(contents.objects)
    setattr(changing, part, {"base_link": 0.5})
    assert not changing.contents().looks_same(contents)


def test_a_forgotten_object_has_neither_colour_nor_entries():
    changing = draft(CUP)
    changing.colors["gripper_link"] = {}
    changing.forget("gripper_link")
    assert changing.colors == {}
    assert "gripper_link" not in changing.allowed_collisions.names


def test_clearing_keeps_attached_objects():
    changing = draft(CUP)
    changing.attached = {"cup": changing.objects["cup"]}
    changing.clear(changing.allowed_collisions)
    assert changing.objects == {}
    assert list(changing.attached) == ["cup"]


def test_planners_get_the_whole_scene():
    scene = scene_state(CUP).contents.as_scene(7, ROBOT)
    assert (scene.version, [thing.name for thing in scene.objects], scene.allowed) == (7, ["cup"], {})


OF_ROBOT = AllowedCollisionMatrix.of_robot(ROBOT)
RED = {"r": 1.0, "a": 1.0}
ACM = {"entry_names": ["a", "b"], "entry_values": [{"enabled": [False, True]}, {"enabled": [True, False]}]}


def changed(*messages, before=(CUP,)):
    changing = draft(*before)
    for each in messages:
        apply_planning_scene(changing, each, OF_ROBOT)
    return changing


def test_a_diff_keeps_objects_that_it_does_not_name():
    changing = changed(diff(name="kitchen", world={"collision_objects": [box("new")]}))
    assert (list(changing.objects), changing.name) == (["cup", "new"], "kitchen")


def test_a_whole_scene_replaces_the_one_before():
    changing = changed(
        diff(
            robot_state={"attached_collision_objects": [held("cup")]},
            allowed_collision_matrix=ACM,
            link_padding=[{"link_name": "wrist_link", "padding": 0.1}],
            object_colors=[{"id": "cup", "color": RED}],
        ),
        message("PlanningScene", world={"collision_objects": [box("new")]}),
    )
    assert (list(changing.objects), changing.attached) == (["new"], {})
    assert (changing.allowed_collisions, changing.padding_m, changing.colors) == (OF_ROBOT, {}, {})


def test_a_whole_scene_with_a_diff_state_keeps_attached_objects():
    changing = changed(
        diff(robot_state={"attached_collision_objects": [held("cup")]}),
        message("PlanningScene", robot_state={"is_diff": True}),
    )
    assert list(changing.attached) == ["cup"]


def test_attached_objects_change_before_those_of_the_world():
    """A thing is put down and removed by one message."""
    told = diff(
        robot_state={"attached_collision_objects": [held("cup", operation=1)]},
        world={"collision_objects": [{"id": "cup", "operation": 1}]},
    )
    changing = changed(diff(robot_state={"attached_collision_objects": [held("cup")]}), told)
    assert (changing.attached, changing.objects) == ({}, {})


@pytest.mark.parametrize(
    ("state", "still_held"),
    [
        ({"is_diff": False}, ["cup"]),
        ({"is_diff": True, "joint_state": {"name": ["gripper"], "position": [0.0]}}, ["cup"]),
        ({"is_diff": False, "joint_state": {"name": ["gripper"], "position": [0.0]}}, []),
        ({"is_diff": False, "attached_collision_objects": [held("pen", **box("pen"))]}, ["pen"]),
    ],
)
def test_a_state_that_is_no_diff_detaches_unlisted_objects_unless_it_is_empty(state, still_held):
    take = diff(robot_state={"attached_collision_objects": [held("cup")]})
    assert list(changed(take, diff(robot_state=state)).attached) == still_held


def test_missing_fields_change_nothing_but_a_state_of_attached_objects_does():
    take = diff(robot_state={"attached_collision_objects": [held("cup")]})
    assert list(changed(take, {"is_diff": True}).attached) == ["cup"]
    emptied = {"is_diff": True, "robot_state": {"is_diff": False, "attached_collision_objects": []}}
    assert changed(take, emptied).attached == {}


def test_a_matrix_replaces_the_one_before_and_an_empty_one_is_ignored():
    changing = changed(diff(allowed_collision_matrix=ACM), diff())
    assert changing.allowed_collisions.names == ("a", "b")


def test_padding_and_scale_are_kept_unless_they_are_the_default():
    padding = [{"link_name": link, "padding": value} for link, value in (("wrist_link", 0.01), ("base_link", 0.0))]
    scale = [{"link_name": link, "scale": value} for link, value in (("wrist_link", 1.1), ("base_link", 1.0))]
    changing = changed(diff(link_padding=padding, link_scale=scale))
    assert (changing.padding_m, changing.scale) == ({"wrist_link": 0.01}, {"wrist_link": 1.1})
    back = diff(link_padding=[{"link_name": "wrist_link", "padding": 0.0}])
    assert changed(diff(link_padding=padding), back).padding_m == {}


def test_fixed_frames_are_kept_and_the_planning_frame_is_ignored():
    wall = {"header": {"frame_id": "base_link"}, "child_frame_id": "/wall", "transform": {"translation": {"x": 2.0}}}
    root = {"header": {"frame_id": "base_link"}, "child_frame_id": "base_link"}
    assert changed(diff(fixed_frame_transforms=[wall, root])).fixed_frames == {"wall": Pose((2.0, 0.0, 0.0))}


def test_an_octomap_without_data_is_accepted():
    empty = {"octomap": {"octomap": {"id": "OcTree", "resolution": 0.1}}}
    assert list(changed(diff(world=empty)).objects) == ["cup"]


def test_the_world_alone_is_changed_as_within_a_scene():
    changing = draft(CUP)
    apply_world(changing, message("PlanningSceneWorld", collision_objects=[box("new")]), "world")
    assert list(changing.objects) == ["cup", "new"]


CROWD = [box(str(i)) for i in range(MAX_SHAPES + 1)]
MANY = [{"id": str(i), "color": RED} for i in range(MAX_COLORS + 1)]
BAD = {
    "an octomap": ({"world": {"octomap": {"octomap": {"data": [1, 2]}}}}, -22, "world.octomap must be empty"),
    "a crowd": ({"world": {"collision_objects": CROWD}}, -16, f"world brings {MAX_SHAPES + 1} shapes; a scene holds"),
    "the second object": ({"world": {"collision_objects": [box("a"), {"id": "b"}]}}, -16, "world.collision_objects[1]"),
    "what is held": (
        {"robot_state": {"attached_collision_objects": [held("ghost")]}},
        -19,
        "robot_state.attached_collision_objects[0].object: the object 'ghost'",
    ),
    "padding of an unknown link": (
        {"link_padding": [{"link_name": "hand"}]},
        -18,
        "link_padding: there is no link 'hand'",
    ),
    "padding below 0": (
        {"link_padding": [{"link_name": "base_link", "padding": -0.1}]},
        -16,
        "at least 0, up to 100, not -0.1",
    ),
    "scale of NaN": (
        {"link_scale": [{"link_name": "base_link", "scale": math.nan}]},
        -16,
        "above 0, up to 100, not nan",
    ),
    "scale of 0": ({"link_scale": [{"link_name": "base_link", "scale": 0.0}]}, -16, "above 0, up to 100, not 0"),
    "a colour of NaN": (
        {"object_colors": [{"id": "a", "color": {"r": math.nan}}]},
        -16,
        "object_colors[0].color of 'a'",
    ),
    "too many colours": ({"object_colors": MANY}, -16, f"more than {MAX_COLORS}"),
    "a frame in another": (
        {"fixed_frame_transforms": [{"header": {"frame_id": "wrist_link"}, "child_frame_id": "x"}]},
        -21,
        "must be the planning frame 'base_link', not 'wrist_link'",
    ),
    "a frame of NaN": (
        {"fixed_frame_transforms": [{"child_frame_id": "x", "transform": {"translation": {"x": math.nan}}}]},
        -16,
        "fixed_frame_transforms[0].transform",
    ),
    "a crooked matrix": (
        {"allowed_collision_matrix": {"entry_names": ["a"]}},
        -16,
        "allowed_collision_matrix.entry_values",
    ),
}


@pytest.mark.parametrize(("fields", "code", "words"), BAD.values(), ids=BAD.keys())
def test_a_bad_field_is_rejected_with_its_path(fields, code, words):
    failure = rejection(changed, diff(**fields))
    assert failure.code is MoveItErrorCode(code)
    assert words in failure.message


QUARTER = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
TURNED_CUP = collision_object(**box("cup", at=pose(0.3, turned=QUARTER)))
BALL = {"type": 2, "dimensions": [0.1]}


def after_objects(*messages, before=(TURNED_CUP,)):
    changing = draft(*before)
    for each in messages:
        apply_collision_object(changing, collision_object(**each), "it")
    return changing


def test_add_transforms_an_object_from_its_frame():
    lid = after_objects(box("lid", at=pose(0.1), frame="cup")).objects["lid"]
    np.testing.assert_allclose(lid.pose.position_m, (0.3, 0.1, 0.0), atol=1e-12)


def test_add_in_the_frame_of_a_link_stays_where_the_link_is_now():
    thing = after_objects(box("lid", frame="gripper_link")).objects["lid"]
    np.testing.assert_allclose(matrix_of(thing.pose), FORWARD.transforms(BENT)["gripper_link"], atol=1e-12)


def test_add_replaces_an_object_of_the_same_name():
    thing = after_objects({"id": "cup", "primitives": [BALL]}).objects["cup"]
    assert thing.shapes == ((Sphere(0.1), Pose()),)


def test_add_of_an_equal_object_keeps_the_present_one():
    before = draft(TURNED_CUP)
    known = before.objects["cup"]
    apply_collision_object(
        before, {**TURNED_CUP, "header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": "base_link"}}, "it"
    )
    assert before.objects["cup"] is known


def test_append_adds_shapes_where_the_message_has_them():
    append = {"id": "cup", "primitives": [BALL], "primitive_poses": [pose(0.3, 0.2)], "operation": APPEND}
    thing = after_objects(append).objects["cup"]
    assert thing.pose.position_m == (0.3, 0.0, 0.0)
    assert [type(shape) for shape, _ in thing.shapes] == [Box, Sphere]
    np.testing.assert_allclose(
        (matrix_of(thing.pose) @ matrix_of(thing.shapes[1][1]))[:3, 3], (0.3, 0.2, 0.0), atol=1e-12
    )


def test_append_with_the_objects_own_pose_does_not_round_poses():
    append = {**TURNED_CUP, "primitives": [BALL], "primitive_poses": [pose(0.1)], "operation": APPEND}
    thing = after_objects(append | {"subframe_names": ["rim"], "subframe_poses": [pose(0.2)]}).objects["cup"]
    assert thing.shapes[1][1] == Pose((0.1, 0.0, 0.0))
    assert thing.subframes == {"rim": Pose((0.2, 0.0, 0.0))}


def test_append_keeps_moveits_order_of_kinds():
    plane = {"id": "cup", "planes": [{"coef": [0.0, 0.0, 1.0, 0.0]}], "operation": APPEND}
    ball = {"id": "cup", "primitives": [BALL], "operation": APPEND}
    told = after_objects(plane, ball).objects["cup"].message
    assert [len(told[field]) for field in ("primitives", "primitive_poses", "planes", "plane_poses")] == [2, 2, 1, 1]
    assert told["primitives"][1]["type"] == 2


def test_append_to_an_unknown_object_adds_it():
    assert "new" in after_objects(box("new", operation=APPEND)).objects


def test_append_changes_the_type_only_if_it_has_one():
    typed = {**TURNED_CUP, "type": {"key": "mug", "db": ""}}
    assert after_objects({**TURNED_CUP, "operation": APPEND}, before=(typed,)).objects["cup"].type["key"] == "mug"
    assert after_objects({**typed, "operation": APPEND}).objects["cup"].type["key"] == "mug"


def test_move_needs_no_shapes_and_keeps_all_but_the_pose():
    thing = after_objects({"id": "cup", "pose": pose(0.5), "operation": MOVE}).objects["cup"]
    assert thing.pose == Pose((0.5, 0.0, 0.0))
    assert thing.shapes[0][0] == Box((0.05, 0.05, 0.05))


def test_move_to_the_same_pose_keeps_the_present_object():
    before = draft(TURNED_CUP)
    known = before.objects["cup"]
    apply_collision_object(before, collision_object(id="cup", pose=TURNED_CUP["pose"], operation=MOVE), "it")
    assert before.objects["cup"] is known


def test_move_may_move_the_shapes_within_the_object():
    two = collision_object(id="two", primitives=[BALL, BALL], pose=pose(1.0))
    move = {"id": "two", "pose": pose(2.0), "primitive_poses": [pose(0.1), pose(0.2)], "operation": MOVE}
    thing = after_objects(move, before=(two,)).objects["two"]
    assert [at.position_m[0] for _, at in thing.shapes] == [0.1, 0.2]


def test_move_by_the_pose_of_a_single_shape_moves_the_object():
    thing = after_objects({"id": "cup", "primitive_poses": [pose(0.7)], "operation": MOVE}).objects["cup"]
    assert (thing.pose, thing.shapes[0][1]) == (Pose((0.7, 0.0, 0.0)), Pose())


def test_remove_drops_an_object_its_colour_and_its_entries():
    changing = draft(TURNED_CUP)
    changing.colors["cup"] = {}
    apply_collision_object(changing, collision_object(id="cup", operation=REMOVE), "it")
    assert (changing.objects, changing.colors) == ({}, {})


def test_remove_without_name_drops_everything():
    assert after_objects({"operation": REMOVE}, before=(TURNED_CUP, collision_object(**box("other")))).objects == {}


@pytest.mark.parametrize("operation", [MOVE, REMOVE])
def test_an_unknown_object_cannot_be_moved_or_removed(operation):
    failure = rejection(after_objects, {"id": "ghost", "operation": operation})
    assert failure.code is MoveItErrorCode.INVALID_OBJECT_NAME
    assert "'ghost'" in failure.message


@pytest.mark.parametrize("operation", [ADD, APPEND])
def test_an_object_without_shapes_is_rejected(operation):
    assert "'x' has no shape" in rejection(after_objects, {"id": "x", "operation": operation}).message


def test_move_must_give_as_many_poses_as_there_are_shapes():
    failure = rejection(after_objects, {"id": "cup", "primitive_poses": [pose()] * 2, "operation": MOVE})
    assert "poses of 2 shapes; 'cup' has 1" in failure.message


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ({**box("x"), "operation": 7}, "must be one of 0 (ADD), 1 (REMOVE), 2 (APPEND), 3 (MOVE), not 7"),
        (box("x", frame="nowhere"), "no frame 'nowhere'"),
        ({"id": "cup", "pose": pose(math.nan), "operation": MOVE}, "it.pose.position.x"),
    ],
)
def test_an_object_that_cannot_be_used_is_refused(message, words):
    assert words in rejection(after_objects, message).message


LINKS = FORWARD.transforms(BENT)


def after_attached(*messages, before=(CUP,)):
    changing = draft(*before)
    for each in messages:
        apply_attached_object(changing, each, "it")
    return changing


def place_in_root(thing):
    return LINKS[thing.link] @ matrix_of(thing.collision_object.pose)


def new(name, *, at, frame, **fields):
    return held(name, **{**box(name, at=at, frame=frame), **fields})


def test_attach_by_name_alone_takes_the_object_from_the_world():
    changing = after_attached(held("cup"))
    assert changing.objects == {}
    np.testing.assert_allclose(place_in_root(changing.attached["cup"])[:3, 3], (0.3, 0.0, 0.0), atol=1e-12)


def test_attach_with_shapes_in_the_links_frame_does_not_round_poses():
    thing = after_attached(new("tool", at=pose(0.1), frame="gripper_link")).attached["tool"]
    assert (thing.link, thing.collision_object.pose) == ("gripper_link", Pose((0.1, 0.0, 0.0)))


def test_attach_with_shapes_in_another_frame_transforms_them():
    thing = after_attached(new("tool", at=pose(0.1), frame="cup")).attached["tool"]
    np.testing.assert_allclose(place_in_root(thing)[:3, 3], (0.4, 0.0, 0.0), atol=1e-12)


def test_attach_with_shapes_replaces_an_object_of_the_world():
    changing = after_attached(held("cup", primitives=[BALL], header={"frame_id": "gripper_link"}))
    assert changing.objects == {}
    assert changing.attached["cup"].attached_object.object.shapes[0][0].radius_m == 0.1


def test_touch_links_weight_and_posture_are_kept():
    posture = message("trajectory_msgs/JointTrajectory", joint_names=["gripper"])
    told = {**held("cup", touch_links=("wrist_link", "wrist_link")), "weight": 0.5, "detach_posture": posture}
    thing = after_attached(told).attached["cup"]
    assert (thing.touch_links, thing.weight, thing.detach_posture) == (("wrist_link",), 0.5, posture)


@pytest.mark.parametrize("touch_links", [("wrist_link",), ("wrist_link", "wrist_link")])
def test_attach_of_an_equal_object_keeps_the_present_one(touch_links):
    told = new("tool", at=pose(0.1), frame="gripper_link") | {"touch_links": list(touch_links)}
    before = after_attached(told).contents()
    again = SceneDraft(before, LinkTransforms(ROBOT, FORWARD, None))
    apply_attached_object(again, told, "it")
    assert again.attached["tool"] is before.attached["tool"]


def test_an_object_detached_and_attached_again_is_not_in_the_world():
    before = after_attached(held("cup")).contents()
    again = SceneDraft(before, LinkTransforms(ROBOT, FORWARD, BENT))
    apply_attached_object(again, held("cup", operation=REMOVE), "it")
    apply_attached_object(again, message("AttachedCollisionObject", **before.attached["cup"].message), "it")
    assert (again.attached, again.objects) == (before.attached, {})


def test_attach_by_name_alone_hands_an_object_from_link_to_link():
    changing = after_attached(held("cup"), held("cup", "wrist_link"))
    assert changing.attached["cup"].link == "wrist_link"
    np.testing.assert_allclose(place_in_root(changing.attached["cup"])[:3, 3], (0.3, 0.0, 0.0), atol=1e-12)


def test_append_adds_shapes_and_touch_links():
    append = {"operation": APPEND, "primitives": [BALL], "header": {"frame_id": "gripper_link"}}
    tool = new("tool", at=pose(0.1), frame="gripper_link") | {"touch_links": ["lower_arm_link"]}
    changing = after_attached(tool, held("tool", touch_links=("wrist_link",), **append))
    thing = changing.attached["tool"]
    assert thing.collision_object.pose == Pose((0.1, 0.0, 0.0))
    assert isinstance(thing.attached_object.object.shapes[0][0], Box)
    np.testing.assert_allclose(thing.collision_object.shapes[1][1].position_m, (-0.1, 0.0, 0.0), atol=1e-12)
    assert thing.touch_links == ("lower_arm_link", "wrist_link")


def test_detach_leaves_an_object_where_it_is_now():
    changing = after_attached(held("cup"), held("cup", "", operation=REMOVE))
    assert changing.attached == {}
    np.testing.assert_allclose(matrix_of(changing.objects["cup"].pose), matrix_of(Pose((0.3, 0.0, 0.0))), atol=1e-12)


def test_detach_without_name_detaches_all_objects_of_the_link():
    both = (CUP, collision_object(**box("pen")))
    changing = after_attached(
        held("cup"), held("pen", "wrist_link"), held("", "wrist_link", operation=REMOVE), before=both
    )
    assert (list(changing.attached), list(changing.objects)) == (["cup"], ["pen"])


def test_detach_without_name_and_link_detaches_everything():
    both = (CUP, collision_object(**box("pen")))
    changing = after_attached(held("cup"), held("pen", "wrist_link"), held("", "", operation=REMOVE), before=both)
    assert changing.attached == {}


def test_detach_without_name_from_a_link_without_objects_is_no_error():
    assert after_attached(held("", operation=REMOVE)).attached == {}


BAD_ATTACHED = {
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


@pytest.mark.parametrize(("messages", "code", "words"), BAD_ATTACHED.values(), ids=BAD_ATTACHED.keys())
def test_an_attached_object_that_cannot_be_used_is_refused(messages, code, words):
    failure = rejection(after_attached, *messages)
    assert failure.code is code
    assert words in failure.message
