"""Start states, scenes and problems of requests."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.problem import MoveItErrorCode
from server.graph.permissions import Node
from server.moveit.requests.planning_context import MAX_START_BOUNDS_ERROR_RAD, start_positions
from tests.helpers.fake_arm import HOME
from tests.helpers.moveit import ROBOT, ServiceRig, assert_refused, box, diff, held, message, rejection

ELBOW = ROBOT.joints["elbow_flex"]


def state(positions=None, **fields):
    positions = positions or {}
    return message("RobotState", joint_state={"name": list(positions), "position": list(positions.values())}, **fields)


@given(st.floats(0.0, MAX_START_BOUNDS_ERROR_RAD, exclude_min=True), st.sampled_from([-1.0, 1.0]))
def test_a_start_slightly_beyond_a_limit_is_clamped_with_a_warning(beyond: float, side: float) -> None:
    limit = ELBOW.upper if side > 0.0 else ELBOW.lower
    positions_rad, warnings = start_positions(state({"elbow_flex": limit + side * beyond * 0.999}), HOME, ROBOT)
    assert positions_rad["elbow_flex"] == pytest.approx(limit)
    assert all("elbow_flex" in warning for warning in warnings)


def test_a_state_that_is_none_is_refused_by_name() -> None:
    for name, position, words in (
        (["elbow_flex"], [math.nan], ["'elbow_flex'", "nan"]),
        (["elbow_flex"], [math.inf], ["'elbow_flex'", "inf"]),
        (["knee"], [0.1], ["'knee'", "elbow_flex"]),
        (["elbow_flex"], [], ["1 entries", "0"]),
        (["elbow_flex"] * 2, [0.1, 0.2], ["more than once"]),
    ):
        told = message("RobotState", joint_state={"name": name, "position": position})
        assert_refused(rejection(start_positions, told, HOME, ROBOT), MoveItErrorCode.INVALID_ROBOT_STATE, *words)


HELD = held("mug", **box("mug", frame="gripper_link"))


def test_a_request_starts_at_its_own_state_its_clients_or_that_of_an_arm_that_is_read(rig: ServiceRig) -> None:
    rig.context.assumed.assume(rig.client, {"elbow_flex": 0.7})
    assert rig.context.start(state(), rig.client).start_rad == HOME | {"elbow_flex": 0.7}
    assert rig.context.start(state(), Node("other")).start_rad == HOME
    rig.context.assumed.assume(rig.client, {"elbow_flex": 0.7, "wrist_roll": 0.1})
    start = rig.context.start(state({"elbow_flex": 0.2}), rig.client).start_rad
    assert start == HOME | {"elbow_flex": 0.2, "wrist_roll": 0.1}
    rig.arm.lose_positions()
    assert_refused(rejection(rig.context.start, state(), rig.client), MoveItErrorCode.ROBOT_STATE_STALE)


def test_objects_attached_in_a_start_state_count_for_its_request_alone(rig: ServiceRig) -> None:
    scene = rig.context.start(state(is_diff=True, attached_collision_objects=[HELD]), rig.client).scene
    assert [held.object.name for held in scene.attached] == ["mug"]
    assert not rig.scene_state.scene.attached
    rig.scene_state.apply_diff(diff(robot_state={"attached_collision_objects": [HELD]}), HOME)
    assert rig.context.start(state(), rig.client).scene.attached
    assert not rig.context.start(state(HOME, is_diff=False), rig.client).scene.attached
