import math

import pytest

from planners.problem import MoveItErrorCode
from planners.scene import Pose
from planners.scene_checks import MAX_SHAPES
from server.errors import RefusedError
from server.moveit.scene.allowed_collision_matrix import ContactMatrix
from server.moveit.scene.planning_scene import MAX_COLORS, change_scene, change_world
from tests.helpers.planning_scene import ROBOT, box, collision_object, diff, draft, held, message, pose

OF_ROBOT = ContactMatrix.of_robot(ROBOT)
CUP = collision_object(**box("cup", at=pose(0.3)))
RED = {"r": 1.0, "a": 1.0}
ACM = {"entry_names": ["a", "b"], "entry_values": [{"enabled": [False, True]}, {"enabled": [True, False]}]}


def changed(*messages, before=(CUP,)):
    changing = draft(*before)
    for each in messages:
        change_scene(changing, each, OF_ROBOT)
    return changing


def refusal(told):
    with pytest.raises(RefusedError) as refused:
        changed(told)
    return refused.value.failure


def test_a_difference_leaves_what_it_does_not_name():
    changing = changed(diff(name="kitchen", world={"collision_objects": [box("new")]}))
    assert (list(changing.objects), changing.name) == (["cup", "new"], "kitchen")


def test_a_whole_scene_takes_the_place_of_the_one_before():
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
    assert (changing.matrix, changing.padding_m, changing.colors) == (OF_ROBOT, {}, {})


def test_a_whole_scene_whose_state_is_a_difference_leaves_what_is_held():
    changing = changed(
        diff(robot_state={"attached_collision_objects": [held("cup")]}),
        message("PlanningScene", robot_state={"is_diff": True}),
    )
    assert list(changing.attached) == ["cup"]


def test_what_is_held_changes_before_what_stands_around():
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
def test_a_state_that_is_no_difference_leaves_held_only_what_it_lists_unless_it_is_empty(state, still_held):
    take = diff(robot_state={"attached_collision_objects": [held("cup")]})
    assert list(changed(take, diff(robot_state=state)).attached) == still_held


def test_fields_that_are_left_out_say_nothing_but_a_state_of_held_things_counts():
    take = diff(robot_state={"attached_collision_objects": [held("cup")]})
    assert list(changed(take, {"is_diff": True}).attached) == ["cup"]
    emptied = {"is_diff": True, "robot_state": {"is_diff": False, "attached_collision_objects": []}}
    assert changed(take, emptied).attached == {}


def test_a_matrix_takes_the_place_of_the_one_before_and_an_empty_one_says_nothing():
    changing = changed(diff(allowed_collision_matrix=ACM), diff())
    assert changing.matrix.names == ("a", "b")


def test_padding_and_scale_are_kept_where_they_say_something():
    padding = [{"link_name": link, "padding": value} for link, value in (("wrist_link", 0.01), ("base_link", 0.0))]
    scale = [{"link_name": link, "scale": value} for link, value in (("wrist_link", 1.1), ("base_link", 1.0))]
    changing = changed(diff(link_padding=padding, link_scale=scale))
    assert (changing.padding_m, changing.scale) == ({"wrist_link": 0.01}, {"wrist_link": 1.1})
    back = diff(link_padding=[{"link_name": "wrist_link", "padding": 0.0}])
    assert changed(diff(link_padding=padding), back).padding_m == {}


def test_frames_that_stand_still_are_kept_and_the_planning_frame_says_nothing():
    wall = {"header": {"frame_id": "base_link"}, "child_frame_id": "/wall", "transform": {"translation": {"x": 2.0}}}
    root = {"header": {"frame_id": "base_link"}, "child_frame_id": "base_link"}
    assert changed(diff(fixed_frame_transforms=[wall, root])).fixed_frames == {"wall": Pose((2.0, 0.0, 0.0))}


def test_an_octomap_without_data_is_let_pass():
    empty = {"octomap": {"octomap": {"id": "OcTree", "resolution": 0.1}}}
    assert list(changed(diff(world=empty)).objects) == ["cup"]


def test_the_world_alone_is_changed_as_within_a_scene():
    changing = draft(CUP)
    change_world(changing, message("PlanningSceneWorld", collision_objects=[box("new")]), "world")
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
def test_what_cannot_be_done_is_refused_by_its_field(fields, code, words):
    failure = refusal(diff(**fields))
    assert failure.code is MoveItErrorCode(code)
    assert words in failure.message
