from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.problem import MoveItErrorCode
from server.moveit.requests.planning_context import (
    MAX_START_BOUNDS_ERROR_RAD,
    Start,
    attached_diff,
    start_positions,
    stated_positions,
)
from tests.helpers.moveit_requests import HOME, ROBOT, assert_refused, message

ELBOW = ROBOT.joints["elbow_flex"]
CURRENT = HOME | {"shoulder_pan": 0.3}


def state(positions=None, **fields):
    positions = positions or {}
    joints = {"name": list(positions), "position": list(positions.values())}
    return message("RobotState", joint_state=joints, **fields)


def start(positions=None, current=CURRENT, **fields):
    return start_positions(state(positions, **fields), current, ROBOT)


@pytest.mark.parametrize("is_diff", [True, False])
def test_a_state_without_joints_is_the_present_one(is_diff: bool) -> None:
    assert start(is_diff=is_diff) == Start(CURRENT)


@pytest.mark.parametrize("is_diff", [True, False])
def test_joints_that_are_not_named_are_where_they_are(is_diff: bool) -> None:
    assert start({"elbow_flex": 0.5}, is_diff=is_diff) == Start(CURRENT | {"elbow_flex": 0.5})


def test_a_whole_state_needs_no_present_one() -> None:
    assert start(HOME, current=None) == Start(HOME)


def test_joints_that_nobody_knows_are_named() -> None:
    assert_refused(start({"elbow_flex": 0.5}, current=None), MoveItErrorCode.ROBOT_STATE_STALE, "'shoulder_pan'")


@given(st.floats(0.0, MAX_START_BOUNDS_ERROR_RAD, exclude_min=True), st.sampled_from([-1.0, 1.0]))
def test_a_start_beyond_a_limit_by_a_hair_is_moved_to_it_and_told(beyond: float, side: float) -> None:
    limit = ELBOW.upper if side > 0.0 else ELBOW.lower
    moved = start({"elbow_flex": limit + side * beyond * 0.999})
    assert isinstance(moved, Start)
    assert moved.positions_rad["elbow_flex"] == pytest.approx(limit)
    assert all("elbow_flex" in warning for warning in moved.warnings)


def test_a_start_far_beyond_a_limit_is_refused_with_joint_value_and_limits() -> None:
    failure = assert_refused(
        start({"elbow_flex": 1.8}), MoveItErrorCode.START_STATE_INVALID, "'elbow_flex'", "1.8", "-1.69 to 1.69"
    )
    assert failure.details["joint"] == "elbow_flex"


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_position_that_is_no_number_is_named(value: float) -> None:
    assert_refused(start({"elbow_flex": value}), MoveItErrorCode.INVALID_ROBOT_STATE, "'elbow_flex'", str(value))


def test_an_unknown_joint_is_named_with_those_that_exist() -> None:
    assert_refused(start({"knee": 0.1}), MoveItErrorCode.INVALID_ROBOT_STATE, "'knee'", "elbow_flex")


def test_a_fixed_joint_in_a_state_says_nothing() -> None:
    fixed = next(joint.name for joint in ROBOT.joints.values() if not joint.movable)
    assert start({fixed: 0.0}) == Start(CURRENT)


def test_lists_of_unlike_lengths_are_refused_with_both() -> None:
    uneven = message("RobotState", joint_state={"name": ["elbow_flex"], "position": []})
    assert_refused(start_positions(uneven, CURRENT, ROBOT), MoveItErrorCode.INVALID_ROBOT_STATE, "1 entries", "0")


def test_a_joint_that_is_named_twice_is_refused() -> None:
    twice = message("RobotState", joint_state={"name": ["elbow_flex"] * 2, "position": [0.1, 0.2]})
    assert_refused(start_positions(twice, CURRENT, ROBOT), MoveItErrorCode.INVALID_ROBOT_STATE, "more than once")


def test_joints_of_many_dimensions_are_ignored_with_a_warning() -> None:
    floating = start(multi_dof_joint_state={"joint_names": ["virtual_joint"]})
    assert isinstance(floating, Start)
    assert "multi_dof_joint_state" in floating.warnings[0]


def test_a_state_that_is_asked_about_may_be_beyond_its_limits() -> None:
    asked = stated_positions(state({"elbow_flex": 3.0}), CURRENT, ROBOT)
    assert asked == CURRENT | {"elbow_flex": 3.0}


def test_a_whole_state_says_all_that_is_attached() -> None:
    diff = attached_diff(state({"elbow_flex": 0.1}, is_diff=False))
    assert diff == {"is_diff": True, "robot_state": {"attached_collision_objects": [], "is_diff": False}}


def test_a_diff_says_only_what_it_names() -> None:
    held = {"link_name": "gripper_link", "object": {"id": "mug"}}
    diff = attached_diff(state({"elbow_flex": 0.1}, is_diff=True, attached_collision_objects=[held]))
    assert diff is not None
    assert diff["robot_state"]["is_diff"] is True
    assert diff["robot_state"]["attached_collision_objects"][0]["object"]["id"] == "mug"


@pytest.mark.parametrize(("positions", "is_diff"), [({}, False), ({}, True), ({"elbow_flex": 0.1}, True)])
def test_a_state_that_names_nothing_attached_changes_nothing_attached(positions, is_diff: bool) -> None:
    assert attached_diff(state(positions, is_diff=is_diff)) is None
