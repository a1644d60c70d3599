from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.goals import JointConstraint
from planners.problem import MoveItErrorCode
from server.errors import RefusedError
from server.moveit.requests.constraints import joint_constraints
from tests.helpers.moveit_requests import ROBOT, assert_refused, constraints, context, joint

ELBOW = ROBOT.joints["elbow_flex"]


def read(*messages, reading=None, where="goal_constraints[0]"):
    complete = constraints(joint_constraints=list(messages))["joint_constraints"]
    return joint_constraints(complete, reading or context(), where)


def refusal(*messages):
    with pytest.raises(RefusedError) as raised:
        read(*messages)
    return raised.value.failure


def test_a_constraint_without_tolerances_is_exact() -> None:
    assert read({"joint_name": "elbow_flex", "position": 0.5}) == (JointConstraint("elbow_flex", 0.5, 0.0, 0.0, 0.0),)


@given(st.floats(-1.7, 1.7), st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_positions_are_within_the_limits_and_ranges_contain_them(position, above, below) -> None:
    try:
        (one,) = read(joint("elbow_flex", position, above, below))
    except RefusedError:
        assert not ELBOW.lower <= position <= ELBOW.upper
        return
    assert ELBOW.lower <= one.position_rad <= ELBOW.upper
    assert one.above_rad >= 0.0
    assert one.below_rad >= 0.0


def test_a_position_beyond_the_limit_by_less_than_its_tolerance_goes_to_the_limit_and_is_told() -> None:
    reading = context()
    (one,) = read(joint("elbow_flex", ELBOW.upper + 0.3, below=0.4), reading=reading)
    assert one.position_rad == ELBOW.upper
    assert "elbow_flex" in reading.warnings[0]


def test_a_position_beyond_the_limit_by_a_hair_goes_to_the_limit() -> None:
    (one,) = read(joint("elbow_flex", ELBOW.lower - 0.005))
    assert one.position_rad == ELBOW.lower


def test_a_position_far_beyond_the_limit_is_refused_with_joint_value_and_limits() -> None:
    failure = assert_refused(
        refusal(joint("elbow_flex", 2.0)),
        MoveItErrorCode.INVALID_GOAL_CONSTRAINTS,
        "'elbow_flex'",
        "2",
        "-1.69 to 1.69",
    )
    assert failure.details["upper_rad"] == ELBOW.upper


BAD = {
    "unknown": (joint("knee", 0.1), ("'knee'", "elbow_flex", "goal_constraints[0].joint_constraints[0]")),
    "fixed": (joint("gripper_frame_joint", 0.1), ("'gripper_frame_joint'",)),
    "no number": (joint("elbow_flex", math.nan), ("position", "nan")),
    "negative above": (joint("elbow_flex", 0.1, above=-0.1), ("tolerance_above", "-0.1")),
    "negative below": (joint("elbow_flex", 0.1, below=-0.1), ("tolerance_below", "-0.1")),
    "infinite": (joint("elbow_flex", 0.1, above=math.inf), ("tolerance_above", "inf")),
    "weight": (joint("elbow_flex", 0.1, weight=math.nan), ("weight", "nan")),
}


@pytest.mark.parametrize(("bad", "words"), BAD.values(), ids=BAD.keys())
def test_a_senseless_constraint_is_refused_by_field_and_value(bad, words) -> None:
    assert_refused(refusal(bad), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, *words)


def test_several_on_one_joint_are_their_common_range() -> None:
    (one,) = read(joint("elbow_flex", 0.0, 0.5, 0.5), joint("elbow_flex", 0.6, 0.2, 0.3))
    assert one.position_rad == pytest.approx(0.3)
    assert one.position_rad - one.below_rad == pytest.approx(0.3)
    assert one.position_rad + one.above_rad == pytest.approx(0.5)


def test_several_that_have_nothing_in_common_are_refused_with_the_joint() -> None:
    failure = refusal(joint("elbow_flex", 0.0, 0.1, 0.1), joint("elbow_flex", 0.6, 0.1, 0.1))
    assert_refused(failure, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "'elbow_flex'", "no position")


def test_a_weight_below_zero_counts_as_none() -> None:
    assert read(joint("elbow_flex", 0.1, weight=-3.0))[0].weight == 0.0
