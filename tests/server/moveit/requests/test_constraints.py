"""moveit_msgs/Constraints as goals and as path constraints."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.goals import AnyOf, ConstraintGoal, Constraints, JointConstraint, JointGoal, PoseGoal, PositionGoal
from planners.problem import MoveItErrorCode
from server.errors import RefusedError
from server.moveit.requests.constraints import (
    DEFAULT_TOLERANCE_RAD,
    LEAST_ORIENTATION_TOLERANCE_RAD,
    LEAST_TOLERANCE_M,
    MAX_ALTERNATIVES,
    is_binding,
    is_free,
    read_goal,
    read_joint_constraints,
    read_orientation_constraint,
    read_path_constraints,
    read_regions,
)
from tests.helpers.moveit import (
    BOX,
    CONE,
    CYLINDER,
    ROBOT,
    SEVEN,
    SPHERE,
    TIP,
    assert_refused,
    ball,
    constraints,
    context,
    joint,
    near,
    outcome,
    point,
    region,
    turned,
)

BALL = ball(0.3, 0.0, 0.2, 0.005)


def goal(*messages, reading=None):
    return outcome(read_goal, [constraints(**one) for one in messages], reading or context())


def on_the_way(reading=None, **fields):
    return outcome(read_path_constraints, constraints(**fields), reading or context())


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


def test_a_joint_outside_the_group_at_its_goal_is_ignored_with_a_warning() -> None:
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
    assert_refused(
        outcome(read_goal, [], context()), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "goal_constraints is empty"
    )


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


def test_an_empty_message_has_no_path_constraints() -> None:
    assert on_the_way() == Constraints()


def test_path_constraints_are_read_in_full() -> None:
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


ELBOW = ROBOT.joints["elbow_flex"]


def read_joints(*messages, reading=None, where="goal_constraints[0]"):
    complete = constraints(joint_constraints=list(messages))["joint_constraints"]
    return read_joint_constraints(complete, reading or context(), where)


def joint_refusal(*messages):
    with pytest.raises(RefusedError) as raised:
        read_joints(*messages)
    return raised.value.failure


def test_a_constraint_without_tolerances_is_exact() -> None:
    assert read_joints({"joint_name": "elbow_flex", "position": 0.5}) == (
        JointConstraint("elbow_flex", 0.5, 0.0, 0.0, 0.0),
    )


@given(st.floats(-1.7, 1.7), st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_positions_are_within_the_limits_and_ranges_contain_them(position, above, below) -> None:
    try:
        (one,) = read_joints(joint("elbow_flex", position, above, below))
    except RefusedError:
        assert not ELBOW.lower <= position <= ELBOW.upper
        return
    assert ELBOW.lower <= one.position_rad <= ELBOW.upper
    assert one.above_rad >= 0.0
    assert one.below_rad >= 0.0


def test_a_position_beyond_the_limit_within_its_tolerance_is_clamped_with_a_warning() -> None:
    reading = context()
    (one,) = read_joints(joint("elbow_flex", ELBOW.upper + 0.3, below=0.4), reading=reading)
    assert one.position_rad == ELBOW.upper
    assert "elbow_flex" in reading.warnings[0]


def test_a_position_slightly_beyond_the_limit_is_clamped() -> None:
    (one,) = read_joints(joint("elbow_flex", ELBOW.lower - 0.005))
    assert one.position_rad == ELBOW.lower


def test_a_position_far_beyond_the_limit_is_refused_with_joint_value_and_limits() -> None:
    failure = assert_refused(
        joint_refusal(joint("elbow_flex", 2.0)),
        MoveItErrorCode.INVALID_GOAL_CONSTRAINTS,
        "'elbow_flex'",
        "2",
        "-1.69 to 1.69",
    )
    assert failure.details["upper_rad"] == ELBOW.upper


BAD_JOINTS = {
    "unknown": (joint("knee", 0.1), ("'knee'", "elbow_flex", "goal_constraints[0].joint_constraints[0]")),
    "fixed": (joint("gripper_frame_joint", 0.1), ("'gripper_frame_joint'",)),
    "no number": (joint("elbow_flex", math.nan), ("position", "nan")),
    "negative above": (joint("elbow_flex", 0.1, above=-0.1), ("tolerance_above", "-0.1")),
    "negative below": (joint("elbow_flex", 0.1, below=-0.1), ("tolerance_below", "-0.1")),
    "infinite": (joint("elbow_flex", 0.1, above=math.inf), ("tolerance_above", "inf")),
    "weight": (joint("elbow_flex", 0.1, weight=math.nan), ("weight", "nan")),
}


@pytest.mark.parametrize(("bad", "words"), BAD_JOINTS.values(), ids=BAD_JOINTS.keys())
def test_a_senseless_constraint_is_refused_by_field_and_value(bad, words) -> None:
    assert_refused(joint_refusal(bad), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, *words)


def test_several_on_one_joint_are_their_common_range() -> None:
    (one,) = read_joints(joint("elbow_flex", 0.0, 0.5, 0.5), joint("elbow_flex", 0.6, 0.2, 0.3))
    assert one.position_rad == pytest.approx(0.3)
    assert one.position_rad - one.below_rad == pytest.approx(0.3)
    assert one.position_rad + one.above_rad == pytest.approx(0.5)


def test_several_that_have_nothing_in_common_are_refused_with_the_joint() -> None:
    failure = joint_refusal(joint("elbow_flex", 0.0, 0.1, 0.1), joint("elbow_flex", 0.6, 0.1, 0.1))
    assert_refused(failure, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "'elbow_flex'", "no position")


def test_a_weight_below_zero_counts_as_none() -> None:
    assert read_joints(joint("elbow_flex", 0.1, weight=-3.0))[0].weight == 0.0


HALF = math.sqrt(0.5)


def read_orientation(constraint, reading=None):
    (complete,) = constraints(orientation_constraints=[constraint])["orientation_constraints"]
    return read_orientation_constraint(complete, reading or context(), "here")


def test_a_constraint_without_fields_is_the_root_links_orientation_of_the_tip() -> None:
    one = read_orientation({})
    assert one.link == TIP
    assert one.orientation == (0.0, 0.0, 0.0, 1.0)
    assert one.tolerance_rad == (LEAST_ORIENTATION_TOLERANCE_RAD,) * 3


def test_a_quaternion_of_any_length_is_its_direction() -> None:
    assert read_orientation({"orientation": {"z": 3.0, "w": 3.0}}).orientation == pytest.approx((0.0, 0.0, HALF, HALF))


def test_an_orientation_in_a_link_turns_with_the_link() -> None:
    reading = context(start_rad={"shoulder_pan": 0.7})
    fixed = read_orientation({"header": {"frame_id": TIP}})
    moved = read_orientation({"header": {"frame_id": TIP}}, reading)
    assert moved.orientation != pytest.approx(fixed.orientation)


@pytest.mark.parametrize("value", [-0.1, math.nan])
def test_a_senseless_tolerance_is_refused_by_field_and_value(value: float) -> None:
    with pytest.raises(RefusedError) as raised:
        read_orientation(turned((0.1, value, 0.1)))
    assert_refused(
        raised.value.failure, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "absolute_y_axis_tolerance", f"{value:g}"
    )


def test_an_endless_tolerance_leaves_its_axis_free() -> None:
    assert read_orientation(turned((0.1, 0.1, math.inf))).tolerance_rad[2] >= math.pi


def test_an_orientation_with_three_free_axes_asks_for_nothing() -> None:
    assert is_free((math.pi, 4.0, 7.0))
    assert not is_free((math.pi, math.pi, 3.0))


@pytest.mark.parametrize("tolerance", [0.0, 1e-4, 1e-3, DEFAULT_TOLERANCE_RAD])
def test_default_tolerances_do_not_bind_five_joints(tolerance: float) -> None:
    assert not is_binding(read_orientation(turned(tolerance)).tolerance_rad, context())


@pytest.mark.parametrize("tolerance", [0.02, (0.01, 0.01, math.pi), (0.0, 0.5, 0.0)])
def test_a_tolerance_that_somebody_chose_is_kept(tolerance) -> None:
    assert is_binding(read_orientation(turned(tolerance)).tolerance_rad, context())


def test_an_arm_with_seven_joints_keeps_every_tolerance() -> None:
    assert is_binding((1e-3, 1e-3, 1e-3), context(SEVEN))


AT = point(0.3, 0.0, 0.2)


def read_region(constraint, reading=None):
    (complete,) = constraints(position_constraints=[constraint])["position_constraints"]
    return read_regions(complete, reading or context(), "here")


def region_refusal(constraint):
    with pytest.raises(RefusedError) as raised:
        read_region(constraint)
    return raised.value.failure


def test_a_sphere_is_its_radius_around_its_pose() -> None:
    (one,) = read_region(ball(0.3, 0.0, 0.2, 0.02))
    assert one.constraint.radius_m == one.within_m == 0.02
    assert near(one.constraint.region, (0.3, 0.0, 0.2))
    assert one.constraint.link == TIP


def test_a_box_is_half_its_edges() -> None:
    (one,) = read_region(region((BOX, [0.02, 0.02, 0.03]), poses=[AT]))
    assert one.constraint.half_size_m == (0.01, 0.01, 0.015)
    assert one.within_m == 0.01
    assert not one.elongated


def test_a_box_of_unlike_edges_is_not_taken_for_a_ball() -> None:
    (one,) = read_region(region((BOX, [0.2, 0.02, 0.02]), poses=[AT]))
    assert one.elongated


def test_a_cylinder_is_the_box_within_it() -> None:
    (one,) = read_region(region((CYLINDER, [0.1, 0.02]), poses=[AT]))
    x, y, z = one.constraint.half_size_m
    assert math.hypot(x, y) == pytest.approx(0.02)
    assert z == 0.05


@pytest.mark.parametrize("primitive", [(SPHERE, [0.0]), (BOX, [0.0, 0.0, 0.0])])
def test_a_region_of_no_size_is_as_exact_as_can_be(primitive) -> None:
    (one,) = read_region(region(primitive, poses=[AT]))
    assert one.within_m == LEAST_TOLERANCE_M


@pytest.mark.parametrize("primitives", [[], [(0, [])]])
def test_a_pose_without_a_shape_is_a_point_within_the_default_tolerance(primitives) -> None:
    (one,) = read_region(region(*primitives, poses=[AT]), context(position_tolerance=0.007))
    assert one.within_m == 0.007


def test_every_region_is_read() -> None:
    both = read_region(region((SPHERE, [0.01]), (SPHERE, [0.02]), poses=[AT, point(0.2, 0.0, 0.2)]))
    assert [one.within_m for one in both] == [0.01, 0.02]


def test_the_offset_of_the_point_is_kept() -> None:
    (one,) = read_region(ball(0.3, 0.0, 0.2, target_point_offset={"x": 0.01, "y": 0.02, "z": 0.03}))
    assert one.constraint.offset_m == (0.01, 0.02, 0.03)


BAD_REGIONS = {
    "nothing": (region(poses=[]), ("no region",)),
    "no pose": (region((SPHERE, [0.01]), poses=[]), ("no pose",)),
    "too few poses": (region((SPHERE, [0.01]), (SPHERE, [0.01]), poses=[AT]), ("2 primitives", "1 primitive_poses")),
    "cone": (region((CONE, [0.1, 0.1]), poses=[AT]), ("primitives[0].type", "boxes", "not 4")),
    "dimensions": (region((BOX, [0.1]), poses=[AT]), ("3 values", "not 1")),
    "negative": (region((SPHERE, [-0.1]), poses=[AT]), ("radius", "-0.1")),
    "no number": (region((SPHERE, [math.nan]), poses=[AT]), ("radius", "nan")),
    "no point": (ball(math.nan, 0.0, 0.0), ("primitive_poses[0].position.x", "nan")),
    "offset": (ball(0.3, 0.0, 0.2, target_point_offset={"x": math.inf}), ("target_point_offset.x", "inf")),
    "weight": (ball(0.3, 0.0, 0.2, weight=math.nan), ("weight", "nan")),
    "mesh": ({"constraint_region": {"meshes": [{}], "mesh_poses": [AT]}}, ("meshes",)),
}


@pytest.mark.parametrize(("bad", "words"), BAD_REGIONS.values(), ids=BAD_REGIONS.keys())
def test_a_senseless_region_is_refused_by_field_and_value(bad, words) -> None:
    assert_refused(region_refusal(bad), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "here.", *words)


def test_an_unknown_frame_is_named() -> None:
    failure = region_refusal(ball(0.3, 0.0, 0.2, header={"frame_id": "moon"}))
    assert_refused(failure, MoveItErrorCode.FRAME_TRANSFORM_FAILURE, "'moon'")
