import pytest

from planners.problem import MoveItErrorCode
from planners.scene import Pose
from server.errors import RefusedError
from server.moveit.scene.collision_objects import read_thing
from server.moveit.scene.planning_scene import Draft
from tests.helpers.planning_scene import ROBOT, box, collision_object, draft, pose, scene_state

CUP = collision_object(**box("cup", at=pose(0.3)))


def test_a_draft_leaves_what_it_was_made_of_as_it_is():
    state = scene_state(CUP)
    before = state.contents
    changing = Draft(before, draft().links)
    changing.objects.clear()
    changing.colors["cup"] = {}
    assert list(before.objects) == ["cup"]
    assert before.colors == {}


def test_a_thing_is_placed_by_the_frame_it_is_told_in():
    changing = draft(CUP)
    placed = changing.placed(read_thing(collision_object(**box("lid", at=pose(0.0, 0.0, 0.1))), "cup", "it"))
    assert (placed.frame, placed.pose) == ("base_link", Pose((0.3, 0.0, 0.1)))


def test_a_thing_in_a_frame_that_nobody_knows_is_refused_by_its_name():
    with pytest.raises(RefusedError) as refusal:
        draft().placed(read_thing(collision_object(**box("lid")), "nowhere", "it"))
    failure = refusal.value.failure
    assert failure.code is MoveItErrorCode.FRAME_TRANSFORM_FAILURE
    assert (failure.details["object"], failure.details["frame"]) == ("lid", "nowhere")


def test_scenes_that_differ_in_colour_alone_look_alike():
    contents, changing = scene_state(CUP).contents, draft(CUP)
    changing.objects = dict(contents.objects)
    changing.colors["cup"] = {"r": 1.0}
    assert changing.contents().looks_like(contents)
    assert changing.contents() != contents


@pytest.mark.parametrize("part", ["objects", "padding_m", "scale"])
def test_scenes_that_differ_for_planners_do_not_look_alike(part):
    contents, changing = scene_state(CUP).contents, draft()
    changing.objects = dict(contents.objects)
    setattr(changing, part, {"base_link": 0.5})
    assert not changing.contents().looks_like(contents)


def test_what_is_forgotten_has_neither_colour_nor_entries():
    changing = draft(CUP)
    changing.colors["gripper_link"] = {}
    changing.forget("gripper_link")
    assert changing.colors == {}
    assert "gripper_link" not in changing.matrix.names


def test_beginning_anew_leaves_what_is_held():
    changing = draft(CUP)
    changing.attached = {"cup": changing.objects["cup"]}
    changing.clear(changing.matrix)
    assert changing.objects == {}
    assert list(changing.attached) == ["cup"]


def test_planners_get_the_whole_scene():
    scene = scene_state(CUP).contents.as_scene(7, ROBOT)
    assert (scene.version, [thing.name for thing in scene.objects], scene.allowed) == (7, ["cup"], {})
