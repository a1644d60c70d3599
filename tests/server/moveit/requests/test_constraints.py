from __future__ import annotations

import math

import pytest

from planners.goals import AnyOf, ConstraintGoal, Constraints, JointGoal, PoseGoal, PositionGoal
from planners.problem import MoveItErrorCode
from server.moveit.requests.constraints import MAX_ALTERNATIVES, goal_of, path_constraints_of
from tests.helpers.moveit_requests import (
    BOX,
    SEVEN,
    SPHERE,
    TIP,
    assert_refused,
    ball,
    constraints,
    context,
    joint,
    point,
    region,
    turned,
)

BALL = ball(0.3, 0.0, 0.2, 0.005)


def goal(*messages, reading=None):
    return goal_of([constraints(**one) for one in messages], reading or context())


def on_the_way(reading=None, **fields):
    return path_constraints_of(constraints(**fields), reading or context())


def test_joint_constraints_alone_are_a_joint_goal() -> None:
    asked = goal({"joint_constraints": [joint("elbow_flex", 0.5, 0.1, 0.1), joint("wrist_roll", -0.2)]})
    assert asked == JointGoal({"elbow_flex": 0.5, "wrist_roll": -0.2}, 0.01)


def test_a_position_alone_is_a_position_goal() -> None:
    assert goal({"position_constraints": [BALL]}) == PositionGoal(TIP, (0.3, 0.0, 0.2), 0.005)


def test_a_nearly_cubic_box_is_the_ball_within_it() -> None:
    box = region((BOX, [0.01, 0.01, 0.01]), poses=[point(0.3, 0.0, 0.2)])
    assert goal({"position_constraints": [box]}) == PositionGoal(TIP, (0.3, 0.0, 0.2), 0.005)


def test_a_long_box_stays_a_box() -> None:
    box = region((BOX, [0.2, 0.01, 0.01]), poses=[point(0.3, 0.0, 0.2)])
    asked = goal({"position_constraints": [box]})
    assert isinstance(asked, ConstraintGoal)
    assert asked.constraints.positions[0].half_size_m == (0.1, 0.005, 0.005)


def test_position_and_orientation_of_one_link_are_a_pose_goal() -> None:
    asked = goal({"position_constraints": [BALL], "orientation_constraints": [turned(0.001)]})
    assert isinstance(asked, PoseGoal)
    assert asked.pose.position_m == (0.3, 0.0, 0.2)
    assert not asked.strict


def test_a_chosen_orientation_tolerance_makes_the_pose_strict() -> None:
    asked = goal({"position_constraints": [BALL], "orientation_constraints": [turned((0.1, 0.1, 7.0))]})
    assert isinstance(asked, PoseGoal)
    assert asked.strict
    assert asked.orientation_tolerance_rad[:2] == (0.1, 0.1)


def test_seven_joints_keep_the_orientation() -> None:
    asked = goal({"position_constraints": [BALL], "orientation_constraints": [turned(0.001)]}, reading=context(SEVEN))
    assert isinstance(asked, PoseGoal)
    assert asked.strict


def test_an_orientation_that_is_free_about_every_axis_asks_for_nothing() -> None:
    asked = goal({"position_constraints": [BALL], "orientation_constraints": [turned(math.pi)]})
    assert isinstance(asked, PositionGoal)


def test_several_constraints_are_any_one_of_them() -> None:
    asked = goal({"position_constraints": [BALL]}, {"joint_constraints": [joint("elbow_flex", 0.5)]})
    assert isinstance(asked, AnyOf)
    assert [type(one) for one in asked.goals] == [PositionGoal, JointGoal]


def test_several_regions_are_any_one_of_them() -> None:
    two = region((SPHERE, [0.01]), (SPHERE, [0.02]), poses=[point(0.3, 0.0, 0.2), point(0.2, 0.0, 0.2)])
    asked = goal({"position_constraints": [two]})
    assert isinstance(asked, AnyOf)
    assert len(asked.goals) == 2


def test_joints_and_a_position_hold_together() -> None:
    asked = goal({"position_constraints": [BALL], "joint_constraints": [joint("wrist_roll", 0.3)]})
    assert isinstance(asked, ConstraintGoal)
    assert len(asked.constraints.positions) == len(asked.constraints.joints) == 1
    assert asked.constraints.joints[0].above_rad > 0.0


def test_a_point_away_from_the_links_origin_with_an_orientation_holds_as_a_whole() -> None:
    offset = ball(0.3, 0.0, 0.2, target_point_offset={"x": 0.01})
    asked = goal({"position_constraints": [offset], "orientation_constraints": [turned(0.1)]})
    assert isinstance(asked, ConstraintGoal)


def test_a_joint_outside_the_group_that_is_there_already_is_left_out_and_told() -> None:
    reading = context()
    asked = goal({"joint_constraints": [joint("gripper", 0.0), joint("elbow_flex", 0.5)]}, reading=reading)
    assert asked == JointGoal({"elbow_flex": 0.5}, 0.01)
    assert "gripper" in reading.warnings[0]


def test_a_joint_outside_the_group_that_would_have_to_move_is_refused() -> None:
    refusal = goal({"joint_constraints": [joint("gripper", 1.0)]})
    assert_refused(refusal, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "'arm'", "'gripper'", "elbow_flex")


GRIPPER_AT_HALF = {
    "above": (joint("gripper", 0.4, above=0.15), True),
    "too far above": (joint("gripper", 0.4, above=0.05, below=0.5), False),
    "below": (joint("gripper", 0.6, below=0.15), True),
    "too far below": (joint("gripper", 0.6, below=0.05, above=0.5), False),
}


@pytest.mark.parametrize(("held", "holds"), GRIPPER_AT_HALF.values(), ids=GRIPPER_AT_HALF.keys())
def test_a_joint_outside_the_group_is_there_within_its_tolerance(held, holds: bool) -> None:
    asked = goal({"joint_constraints": [held, joint("elbow_flex", 0.5)]}, reading=context(start_rad={"gripper": 0.5}))
    assert isinstance(asked, JointGoal) == holds


def test_no_goal_is_refused() -> None:
    assert_refused(goal_of([], context()), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "goal_constraints is empty")


def test_an_empty_goal_is_refused_by_its_place() -> None:
    refusal = goal({"position_constraints": [BALL]}, {})
    assert_refused(refusal, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "goal_constraints[1] is empty")


def test_more_alternatives_than_can_be_tried_are_refused() -> None:
    refusal = goal(*[{"position_constraints": [BALL]}] * (MAX_ALTERNATIVES + 1))
    assert_refused(refusal, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, str(MAX_ALTERNATIVES))


def test_visibility_is_refused_with_its_reason() -> None:
    refusal = goal({"position_constraints": [BALL], "visibility_constraints": [{}]})
    assert_refused(refusal, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "visibility_constraints", "sensor")


@pytest.mark.parametrize("where", ["position_constraints", "orientation_constraints"])
def test_an_unknown_link_in_a_goal_is_named(where: str) -> None:
    bad = {"position_constraints": [BALL | {"link_name": "hand"}], "orientation_constraints": [{"link_name": "hand"}]}
    assert_refused(goal({where: bad[where]}), MoveItErrorCode.INVALID_LINK_NAME, "'hand'")


def test_nothing_need_hold_on_the_way_when_nothing_is_said() -> None:
    assert on_the_way() == Constraints()


def test_constraints_on_the_way_are_all_that_is_said() -> None:
    held = on_the_way(
        joint_constraints=[joint("elbow_flex", 0.0, 0.5, 0.5)],
        position_constraints=[BALL],
        orientation_constraints=[turned((0.1, 0.2, 7.0))],
    )
    assert isinstance(held, Constraints)
    assert held.joints[0].joint == "elbow_flex"
    assert held.positions[0].radius_m == 0.005
    assert held.orientations[0].tolerance_rad[:2] == (0.1, 0.2)


def test_on_the_way_a_point_can_be_in_one_region_only() -> None:
    two = region((SPHERE, [0.01]), (SPHERE, [0.02]), poses=[point(0.3, 0.0, 0.2), point(0.2, 0.0, 0.2)])
    refusal = on_the_way(position_constraints=[two])
    assert_refused(refusal, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "path_constraints", "2 regions")


def test_constraints_that_contradict_each_other_are_refused() -> None:
    refusal = on_the_way(joint_constraints=[joint("elbow_flex", 0.5, 0.1, 0.1), joint("elbow_flex", -0.5, 0.1, 0.1)])
    assert_refused(refusal, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "'elbow_flex'")
