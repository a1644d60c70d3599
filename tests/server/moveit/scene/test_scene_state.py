"""The planning scene of the server, and the joint states that clients assume."""

import asyncio
import gc
import logging

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.waiting import TIMEOUT_S
from planners.problem import MoveItErrorCode
from planners.scene import Scene
from server.errors import RefusedError
from server.graph.permissions import Node
from server.moveit.scene.allowed_collision_matrix import MAX_EXCEPTIONS
from server.moveit.scene.scene_state import MAX_WAITING_ELEMENTS, AssumedStates, SceneChange
from tests.helpers.moveit import BENT, ROBOT, box, diff, held, message, pose, rejection, scene_state

ADDED = diff(world={"collision_objects": [box("cup", at=pose(0.3)), box("pen")]})


def test_every_change_that_planners_see_has_its_version_and_a_repeated_message_none():
    state = scene_state()
    versions = {state.scene.version}
    for fields in (
        {"world": {"collision_objects": [box("cup")]}},
        {"robot_state": {"attached_collision_objects": [held("cup")]}},
        {"link_padding": [{"link_name": "wrist_link", "padding": 0.01}]},
        {"allowed_collision_matrix": {"default_entry_names": ["cup"], "default_entry_values": [True]}},
    ):
        state.apply_diff(diff(**fields), BENT)
        versions.add(state.scene.version)
    assert len(versions) == 5
    state, calls = scene_state(), []
    state.apply_diff(ADDED, BENT)
    scene, contents = state.scene, state.contents
    state.on_change(lambda: calls.append(1))
    state.apply_diff(ADDED, BENT)
    assert (state.scene is scene, state.contents is contents, calls) == (True, True, [])


MANY = diff(world={"collision_objects": [box(str(number), at=pose(2.0)) for number in range(100)]})


async def test_a_large_change_is_read_by_a_thread_for_the_scene_as_it_is_then_and_later_ones_wait_for_it():
    state = scene_state()
    removal = diff(world={"collision_objects": [{"id": "7", "operation": 1}]})
    applied = [state.submit(state.diff(each), BENT) for each in (MANY, removal)]
    assert (state.pending, [each.done() for each in applied], len(state.contents.objects)) == (True, [False] * 2, 0)
    state.apply_diff(ADDED, BENT)
    await asyncio.wait_for(state.settled(), TIMEOUT_S)
    assert [each.exception() for each in applied] == [None, None]
    assert state.contents.objects.keys() == {"cup", "pen", *map(str, range(100))} - {"7"}


async def test_a_large_change_that_is_refused_or_no_longer_waited_for_changes_nothing():
    state = scene_state(box("cup"))
    contents = state.contents
    bad = diff(world={"collision_objects": [*MANY["world"]["collision_objects"], {"id": "ghost", "operation": 1}]})
    with pytest.raises(RefusedError, match="no object 'ghost'"):
        await asyncio.wait_for(state.submit(state.diff(bad), BENT), TIMEOUT_S)
    assert state.contents is contents
    await asyncio.wait_for(state.submit(state.diff(ADDED), BENT), TIMEOUT_S)
    assert "pen" in state.contents.objects
    state = scene_state(box("cup"))
    contents = state.contents
    waiting = state.submit(state.diff(MANY), BENT)
    await asyncio.sleep(0)
    waiting.cancel()
    await asyncio.wait_for(state.settled(), TIMEOUT_S)
    assert state.contents is contents


async def test_changes_that_wait_are_bounded_and_one_larger_than_the_bound_is_waited_for():
    state, most = scene_state(), SceneChange(lambda _draft: None, MAX_WAITING_ELEMENTS)
    first, second = (state.submit(most, BENT) for _ in range(2))
    text = (
        f"changes of the scene with {2 * MAX_WAITING_ELEMENTS} elements would wait; the limit is {MAX_WAITING_ELEMENTS}"
    )
    assert str(second.exception()) == text
    await asyncio.wait_for(first, TIMEOUT_S)
    applied = state.submit(SceneChange(lambda _draft: None, MAX_WAITING_ELEMENTS + 1), BENT)
    await asyncio.wait_for(state.settled(), TIMEOUT_S)
    assert applied.done()


def test_a_scene_with_too_many_pairs_of_a_matrix_is_refused_before_they_are_made():
    names = [str(number) for number in range(200)]
    matrix = {"default_entry_names": names, "default_entry_values": [True] * 200}
    boxes = [box(str(number), at=pose(2.0)) for number in range(200)]
    change = diff(allowed_collision_matrix=matrix, world={"collision_objects": boxes})
    failure = rejection(scene_state().apply_diff, change, BENT)
    assert f"the limit is {MAX_EXCEPTIONS}" in failure.message


@given(st.permutations(["good", "good too", "bad"]))
def test_one_bad_object_and_nothing_is_changed(names):
    state = scene_state(box("cup"))
    contents, scene = state.contents, state.scene
    objects = [box(name, frame="nowhere" if name == "bad" else "") for name in names]
    changed = diff(world={"collision_objects": [{"id": "cup", "operation": 1}, *objects]})
    failure = rejection(state.apply_diff, changed, BENT)
    assert failure.code is MoveItErrorCode.FRAME_TRANSFORM_FAILURE
    assert (failure.details["object"], failure.details["frame"]) == ("bad", "nowhere")
    assert (state.contents, state.scene) == (contents, scene)


def test_with_diff_does_not_change_the_scene():
    state = scene_state(box("cup"))
    scene = state.scene
    would_be = state.with_diff(diff(world={"collision_objects": [{"id": "cup", "operation": 1}]}), BENT)
    assert isinstance(would_be, Scene)
    assert would_be.objects == ()
    assert would_be.version != scene.version
    assert state.scene is scene
    assert state.with_diff(diff(), BENT) is scene
    assert rejection(state.with_diff, diff(world={"collision_objects": [{"id": "x"}]}), BENT).details["object"] == "x"


def test_another_robots_name_and_frames_are_ignored_with_a_warning_and_an_unknown_touch_link_is_refused(caplog):
    state, touching = scene_state(box("cup")), held("cup", touch_links=("hand",))
    frames = [{"child_frame_id": name} for name in (ROBOT.root_link, "camera")]
    with caplog.at_level(logging.WARNING, "armbridge"):
        state.apply_diff(diff(robot_model_name="panda", fixed_frame_transforms=frames), BENT)
    assert "'panda'" in caplog.text
    assert "'camera'" in caplog.text
    assert ROBOT.root_link not in caplog.text
    assert rejection(state.apply, state.attached_object(touching).apply, BENT).code is MoveItErrorCode.INVALID_LINK_NAME


def test_a_difference_leaves_the_other_joints_a_whole_state_does_not_and_a_client_that_has_left_is_forgotten():
    assumed, node = AssumedStates(ROBOT), Node("client")
    assumed.assume(node, {"gripper": 0.5})
    joint_state = {"name": ["wrist_roll"], "position": [0.1]}
    for is_diff, expected in ((True, {"gripper": 0.5, "wrist_roll": 0.1}), (False, {"wrist_roll": 0.1})):
        assert assumed.after(node, message("RobotState", joint_state=joint_state, is_diff=is_diff)) == expected
    assert len(assumed._assumed) == 1
    del node
    gc.collect()
    assert len(assumed._assumed) == 0
