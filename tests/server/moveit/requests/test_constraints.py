"""moveit_msgs/Constraints as goals and as path constraints."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.goals import ConstraintGoal, JointGoal, PositionGoal
from planners.problem import MoveItErrorCode
from server.errors import RefusedError
from server.moveit.requests.constraints import (
    DEFAULT_TOLERANCE_RAD,
    MAX_ALTERNATIVES,
    is_binding,
    read_goal,
    read_joint_constraints,
    read_orientation_constraint,
    read_path_constraints,
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
    outcome,
    point,
    region,
    rejection,
    turned,
)

BALL = ball(0.3, 0.0, 0.2, 0.005)
AT = point(0.3, 0.0, 0.2)


def goal(*messages, reading=None):
    return outcome(read_goal, [constraints(**one) for one in messages], reading or context())


def on_the_way(reading=None, **fields):
    return outcome(read_path_constraints, constraints(**fields), reading or context())


def test_a_goal_of_several_constraints_holds_as_a_whole() -> None:
    box = region((BOX, [0.2, 0.01, 0.01]), poses=[AT])
    assert goal({"position_constraints": [box]}).constraints.positions[0].half_size_m == (0.1, 0.005, 0.005)
    both = goal({"position_constraints": [BALL], "joint_constraints": [joint("wrist_roll", 0.3)]}).constraints
    assert len(both.positions) == len(both.joints) == 1
    assert both.joints[0].above_rad > 0.0
    # A point away from the link's origin moves with the orientation.
    offset = ball(0.3, 0.0, 0.2, target_point_offset={"x": 0.01})
    assert isinstance(
        goal({"position_constraints": [offset], "orientation_constraints": [turned(0.1)]}), ConstraintGoal
    )


def test_a_joint_outside_the_group_at_its_goal_is_ignored_with_a_warning() -> None:
    reading = context()
    asked = goal({"joint_constraints": [joint("gripper", 0.0), joint("elbow_flex", 0.5)]}, reading=reading)
    assert asked == JointGoal({"elbow_flex": 0.5}, 0.01)
    assert "gripper" in reading.warnings[0]


HAND = {"link_name": "hand"}
INVALID, UNKNOWN_LINK = MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, MoveItErrorCode.INVALID_LINK_NAME
BAD_GOALS = [
    ([{"position_constraints": [BALL]}, {}], INVALID, ["goal_constraints[1] is empty"]),
    ([{"position_constraints": [BALL]}] * (MAX_ALTERNATIVES + 1), INVALID, [str(MAX_ALTERNATIVES)]),
    ([{"position_constraints": [BALL], "visibility_constraints": [{}]}], INVALID, ["visibility_constraints", "sensor"]),
    ([{"position_constraints": [BALL | HAND]}], UNKNOWN_LINK, ["'hand'"]),
    ([{"orientation_constraints": [HAND]}], UNKNOWN_LINK, ["'hand'"]),
    ([{"joint_constraints": [joint("gripper", 1.0)]}], INVALID, ["'arm'", "'gripper'", "elbow_flex"]),
]


@pytest.mark.parametrize(("messages", "code", "words"), BAD_GOALS)
def test_a_goal_that_cannot_be_is_refused_by_its_place(messages, code, words) -> None:
    assert_refused(goal(*messages), code, *words)


def test_path_constraints_are_read_in_full_and_refused_if_they_cannot_be() -> None:
    elbow, orientation = joint("elbow_flex", 0.0, 0.5, 0.5), turned((0.1, 0.2, 7.0))
    held = on_the_way(joint_constraints=[elbow], position_constraints=[BALL], orientation_constraints=[orientation])
    assert (held.joints[0].joint, held.positions[0].radius_m) == ("elbow_flex", 0.005)
    assert held.orientations[0].tolerance_rad[:2] == (0.1, 0.2)
    for fields, words in (
        ({"position_constraints": [region((SPHERE, [0.01]), (SPHERE, [0.02]), poses=[AT] * 2)]}, "2 regions"),
        ({"visibility_constraints": [{}]}, "path_constraints.visibility_constraints"),
        ({"joint_constraints": [joint("elbow_flex", angle, 0.1, 0.1) for angle in (0.5, -0.5)]}, "'elbow_flex'"),
    ):
        assert_refused(on_the_way(**fields), INVALID, "path_constraints", words)


ELBOW = ROBOT.joints["elbow_flex"]


def read_joints(*messages, reading=None):
    complete = constraints(joint_constraints=list(messages))["joint_constraints"]
    return read_joint_constraints(complete, reading or context(), "goal_constraints[0]")


@given(st.floats(-1.7, 1.7), st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_positions_are_within_the_limits_and_ranges_contain_them(position, above, below) -> None:
    try:
        (one,) = read_joints(joint("elbow_flex", position, above, below))
    except RefusedError:
        assert not ELBOW.lower <= position <= ELBOW.upper
        return
    assert ELBOW.lower <= one.position_rad <= ELBOW.upper
    assert min(one.above_rad, one.below_rad) >= 0.0


def test_a_position_beyond_the_limit_is_clamped_within_its_tolerance_and_else_refused() -> None:
    reading = context()
    (one,) = read_joints(joint("elbow_flex", ELBOW.upper + 0.3, below=0.4), reading=reading)
    assert one.position_rad == ELBOW.upper
    assert "elbow_flex" in reading.warnings[0]
    failure = rejection(read_joints, joint("elbow_flex", 2.0))
    assert_refused(failure, INVALID, "'elbow_flex'", "2", "-1.69 to 1.69")
    assert failure.details["upper_rad"] == ELBOW.upper


def test_a_senseless_constraint_is_refused_by_field_and_value() -> None:
    for bad, words in (
        (joint("knee", 0.1), ("'knee'", "elbow_flex", "goal_constraints[0].joint_constraints[0]")),
        (joint("gripper_frame_joint", 0.1), ("'gripper_frame_joint'",)),
        (joint("elbow_flex", math.nan), ("position", "nan")),
        (joint("elbow_flex", 0.1, above=-0.1), ("tolerance_above", "-0.1")),
        (joint("elbow_flex", 0.1, below=-0.1), ("tolerance_below", "-0.1")),
        (joint("elbow_flex", 0.1, above=math.inf), ("tolerance_above", "inf")),
        (joint("elbow_flex", 0.1, weight=math.nan), ("weight", "nan")),
    ):
        assert_refused(rejection(read_joints, bad), INVALID, *words)


def test_several_on_one_joint_are_their_common_range() -> None:
    (one,) = read_joints(joint("elbow_flex", 0.0, 0.5, 0.5), joint("elbow_flex", 0.6, 0.2, 0.3))
    ends_rad = one.position_rad - one.below_rad, one.position_rad + one.above_rad
    assert (one.position_rad, *ends_rad) == pytest.approx((0.3, 0.3, 0.5))


def read_orientation(constraint, reading=None):
    (complete,) = constraints(orientation_constraints=[constraint])["orientation_constraints"]
    return read_orientation_constraint(complete, reading or context(), "here")


def test_an_orientation_in_a_link_turns_with_the_link() -> None:
    fixed = read_orientation({"header": {"frame_id": TIP}})
    moved = read_orientation({"header": {"frame_id": TIP}}, context(start_rad={"shoulder_pan": 0.7}))
    assert moved.orientation != pytest.approx(fixed.orientation)


@pytest.mark.parametrize("value", [-0.1, math.nan])
def test_a_senseless_tolerance_is_refused_by_field_and_value(value: float) -> None:
    raised = rejection(read_orientation, turned((0.1, value, 0.1)))
    assert_refused(raised, INVALID, "absolute_y_axis_tolerance", f"{value:g}")


def test_chosen_tolerances_bind_five_joints_and_all_bind_seven() -> None:
    for tolerances, robot, binds in (
        ((0.0, 1e-4, 1e-3, DEFAULT_TOLERANCE_RAD), ROBOT, False),
        ((0.02, (0.01, 0.01, math.pi), (0.0, 0.5, 0.0)), ROBOT, True),
        ((1e-3,), SEVEN, True),
    ):
        for each in tolerances:
            assert is_binding(read_orientation(turned(each)), context(robot)) is binds, each


def test_the_goal_of_a_region_is_its_middle_and_a_cylinder_is_the_box_within_it() -> None:
    assert goal({"position_constraints": [ball(0.3, 0.0, 0.2, 0.02)]}) == PositionGoal(TIP, (0.3, 0.0, 0.2), 0.02)
    box = region((BOX, [0.02, 0.02, 0.03]), poses=[AT])
    assert goal({"position_constraints": [box]}).tolerance_m == 0.01
    assert on_the_way(position_constraints=[box]).positions[0].half_size_m == (0.01, 0.01, 0.015)
    cylinder = region((CYLINDER, [0.1, 0.02]), poses=[AT])
    x, y, z = on_the_way(position_constraints=[cylinder]).positions[0].half_size_m
    assert math.hypot(x, y) == pytest.approx(0.02)
    assert z == 0.05


@pytest.mark.parametrize("primitives", [[], [(0, [])]])
def test_a_pose_without_a_shape_is_a_point_within_the_default_tolerance(primitives) -> None:
    bare = region(*primitives, poses=[AT])
    assert goal({"position_constraints": [bare]}, reading=context(position_tolerance=0.007)).tolerance_m == 0.007


BAD_REGIONS = [
    (region(poses=[]), ("no region",)),
    (region((SPHERE, [0.01]), poses=[]), ("no pose",)),
    (region((SPHERE, [0.01]), (SPHERE, [0.01]), poses=[AT]), ("2 primitives", "1 primitive_poses")),
    (region((CONE, [0.1, 0.1]), poses=[AT]), ("primitives[0].type", "boxes", "not 4")),
    (region((BOX, [0.1]), poses=[AT]), ("3 values", "not 1")),
    (region((SPHERE, [-0.1]), poses=[AT]), ("radius", "-0.1")),
    (region((SPHERE, [math.nan]), poses=[AT]), ("radius", "nan")),
    (ball(math.nan, 0.0, 0.0), ("primitive_poses[0].position.x", "nan")),
    (ball(0.3, 0.0, 0.2, target_point_offset={"x": math.inf}), ("target_point_offset.x", "inf")),
    (ball(0.3, 0.0, 0.2, weight=math.nan), ("weight", "nan")),
    ({"constraint_region": {"meshes": [{}], "mesh_poses": [AT]}}, ("meshes",)),
]


@pytest.mark.parametrize(("bad", "words"), BAD_REGIONS)
def test_a_senseless_region_is_refused_by_field_and_value(bad, words) -> None:
    assert_refused(on_the_way(position_constraints=[bad]), INVALID, "path_constraints.position_constraints[0].", *words)


def test_an_empty_link_is_the_configured_one_of_the_configured_group_only() -> None:
    assert context(end_effector_link="wrist_link").link("") == "wrist_link"
    assert context(group="gripper", end_effector_link="wrist_link").link("") == "moving_jaw_so101_v1_link"
