import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from server.moveit.current_state import state_message
from server.moveit.scene.interface import (
    ALLOWED_COLLISION_MATRIX,
    EVERYTHING,
    LINK_PADDING_AND_SCALING,
    NO_STATE,
    OBJECT_COLORS,
    OCTOMAP,
    ROBOT_STATE,
    ROBOT_STATE_ATTACHED_OBJECTS,
    SCENE_SETTINGS,
    TRANSFORMS,
    WORLD_OBJECT_GEOMETRY,
    WORLD_OBJECT_NAMES,
    difference,
    scene_message,
)
from server.moveit.scene.scene_state import SceneState
from tests.helpers.examples import examples
from tests.helpers.planning_scene import BENT, ROBOT, box, diff, held, message, pose, scene_state

STATE = state_message(BENT, ROBOT.root_link, 0.0)
RED = {"r": 1.0, "g": 0.0, "b": 0.0, "a": 1.0}
WALL = {"child_frame_id": "wall", "header": {"frame_id": "base_link"}, "transform": {"translation": {"x": 2.0}}}
RACK = {**box("rack", at=pose(0.3)), "subframe_names": ["hook"], "subframe_poses": [pose(0.1)]}
SETTINGS = {
    "name": "kitchen",
    "link_padding": [{"link_name": "wrist_link", "padding": 0.01}],
    "link_scale": [{"link_name": "wrist_link", "scale": 1.25}],
    "object_colors": [{"id": "rack", "color": RED}],
    "fixed_frame_transforms": [WALL],
    "allowed_collision_matrix": {"default_entry_names": ["rack"], "default_entry_values": [True]},
}


def full():
    state = scene_state(RACK, box("cup"))
    assert state.apply_diff(diff(robot_state={"attached_collision_objects": [held("cup")]}, **SETTINGS), BENT) is None
    return state


FULL = full()


def told(components):
    return scene_message(FULL.contents, ROBOT, STATE, components)


@pytest.mark.parametrize("components", [0, *(1 << bit for bit in range(10)), 671, EVERYTHING])
def test_every_field_is_there_whatever_is_asked_for(components):
    assert message("PlanningScene", **told(components)) == told(components)


def test_asking_for_nothing_gets_everything():
    assert told(0) == told(EVERYTHING)


FIELDS = {
    "name": SCENE_SETTINGS,
    "robot_model_name": SCENE_SETTINGS,
    "fixed_frame_transforms": TRANSFORMS,
    "allowed_collision_matrix": ALLOWED_COLLISION_MATRIX,
    "link_padding": LINK_PADDING_AND_SCALING,
    "link_scale": LINK_PADDING_AND_SCALING,
    "object_colors": OBJECT_COLORS,
}


@pytest.mark.parametrize(("field", "component"), FIELDS.items())
def test_a_field_is_told_when_it_is_asked_for_and_else_is_empty(field, component):
    nothing = message("PlanningScene")
    assert told(component)[field] == told(0)[field] != nothing[field]
    assert told(EVERYTHING - component)[field] == nothing[field]


def test_things_are_told_by_name_or_with_their_shapes():
    (named,), (shaped,) = (told(c)["world"]["collision_objects"] for c in (WORLD_OBJECT_NAMES, WORLD_OBJECT_GEOMETRY))
    assert (named["id"], named["primitives"]) == ("rack", [])
    assert (shaped["id"], shaped["header"]["frame_id"], len(shaped["primitives"])) == ("rack", "base_link", 1)
    assert told(OCTOMAP)["world"]["collision_objects"] == []


def test_the_state_is_told_with_or_without_what_is_held():
    assert told(ROBOT_STATE)["robot_state"] == STATE
    with_held = told(ROBOT_STATE_ATTACHED_OBJECTS)["robot_state"]
    assert with_held["joint_state"] == STATE["joint_state"]
    assert [each["object"]["id"] for each in with_held["attached_collision_objects"]] == ["cup"]
    assert told(SCENE_SETTINGS)["robot_state"] == NO_STATE


def test_a_scene_told_to_another_server_and_asked_there_is_the_same():
    other = SceneState(ROBOT)
    assert other.apply_diff(message("PlanningScene", **told(EVERYTHING)), BENT) is None
    assert scene_message(other.contents, ROBOT, STATE, EVERYTHING) == told(EVERYTHING)


def test_a_scene_sent_back_changes_nothing_be_it_as_a_difference_or_whole():
    state = full()
    contents, scene = state.contents, state.scene
    for is_diff in (True, False):
        sent = message("PlanningScene", **scene_message(contents, ROBOT, STATE, EVERYTHING)) | {"is_diff": is_diff}
        assert state.apply_diff(sent, BENT) is None
        assert (state.contents, state.scene) == (contents, scene)


ADD = {"world": {"collision_objects": [box("a")]}}
MOVE = {"world": {"collision_objects": [box("a", at=pose(0.1))]}}
REMOVE_ALL = {"world": {"collision_objects": [{"id": "", "operation": 1}]}}
TAKE = {"robot_state": {"attached_collision_objects": [held("a", **box("a"))]}}
PUT_DOWN = {"robot_state": {"attached_collision_objects": [held("", "", operation=1)]}}
CHANGES = [
    ADD,
    MOVE,
    REMOVE_ALL,
    TAKE,
    PUT_DOWN,
    {"world": {"collision_objects": [box("b", at=pose(0.1))]}},
    {"robot_state": {"attached_collision_objects": [held("b", "wrist_link", **box("b", at=pose(0.2)))]}},
    *({field: value} for field, value in SETTINGS.items() if field != "object_colors"),
]


def after(changes):
    state = SceneState(ROBOT)
    for change in changes:
        # Some contradict what there is; those change nothing.
        state.apply_diff(diff(**change), BENT)
    return state


@example([ADD], [MOVE])
@example([ADD], [TAKE])
@example([TAKE], [PUT_DOWN])
@example([TAKE], [PUT_DOWN, REMOVE_ALL])
@examples(30)
@given(st.lists(st.sampled_from(CHANGES), max_size=4), st.lists(st.sampled_from(CHANGES), max_size=4))
def test_a_difference_makes_one_scene_of_another(first, then):
    follower, leader = after(first), after([*first, *then])
    sent = difference(follower.contents, leader.contents, ROBOT)
    assert follower.apply_diff(message("PlanningScene", **sent), BENT) is None
    for part in ("objects", "attached"):
        ours, theirs = getattr(follower.contents, part), getattr(leader.contents, part)
        assert {name: each.message for name, each in ours.items()} == {name: e.message for name, e in theirs.items()}
    assert (follower.contents.padding_m, follower.contents.scale) == (leader.contents.padding_m, leader.contents.scale)
    assert follower.contents.matrix == leader.contents.matrix


@pytest.mark.parametrize(("one", "other"), [(SceneState(ROBOT), FULL), (FULL, SceneState(ROBOT))])
def test_a_difference_is_a_complete_message(one, other):
    sent = difference(one.contents, other.contents, ROBOT)
    completed = message("PlanningScene", **sent)
    assert {**completed, "robot_state": {}} == {**sent, "robot_state": {}}
