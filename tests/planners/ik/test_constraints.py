import numpy as np
import pinocchio as pin
import pytest

from planners.goals import AxisGoal, Constraints, JointConstraint, OrientationConstraint, PoseGoal, PositionConstraint
from planners.ik import constraints
from planners.ik.constraints import AxisCondition, ConditionSet, TurnCondition, conditions, goal_conditions
from planners.scene import Pose

TIP = "gripper_frame_link"
HOME = np.zeros(6)
UP = np.array([0.0, 0.0, 1.0])


def violated(condition, turn_rad=(0.0, 0.0, 0.0), position_m=(0.0, 0.0, 0.0)):
    placed = pin.SE3(pin.exp3(np.array(turn_rad)), np.array(position_m))
    return condition.violation(condition.error(placed)).any()


def test_box_region_lies_along_its_own_axes():
    quarter = pin.exp3(np.array([0.0, 0.0, np.pi / 2]))
    region = constraints.PointCondition("tip", np.zeros(3), np.zeros(3), quarter, np.array([0.3, 0.1, 0.1]))
    assert not violated(region, position_m=(0.0, 0.25, 0.0))
    assert violated(region, position_m=(0.25, 0.0, 0.0))


def test_axis_that_is_parallel_or_opposite_has_a_finite_way_and_does_not_mind_turns_about_itself():
    for direction, angle in ((UP, 0.0), (-UP, np.pi)):
        error = AxisCondition("tip", UP, direction, 0.1).error(pin.SE3.Identity())
        assert np.linalg.norm(error) == pytest.approx(angle)
    condition = AxisCondition("tip", UP, UP, np.array([0.1, 0.1, np.pi]))
    assert not violated(condition, (0.0, 0.0, 3.0))
    assert violated(condition, (0.2, 0.0, 0.0))


@pytest.fixture
def forward(goal_states):
    return goal_states.forward


@pytest.fixture
def condition_set(forward, collision):
    return lambda **parts: ConditionSet(forward, conditions(Constraints(**parts), collision))


def pose_of(forward, q, link=TIP):
    forward.place(q)
    values = pin.SE3ToXYZQUAT(forward.placement(link)).tolist()
    return Pose(tuple(values[:3]), tuple(values[3:]))


def test_a_pose_of_a_configuration_holds_there_and_not_elsewhere(forward, collision):
    for q in np.random.default_rng(0).uniform(collision.lower_rad, collision.upper_rad, (5, 6)):
        goal = PoseGoal(TIP, pose_of(forward, q), 0.01, (0.05, 0.05, 0.05), strict=True)
        wanted = ConditionSet(forward, goal_conditions(goal, collision).required)
        assert wanted.holds(q)
        assert wanted.deviation(q).position_m == pytest.approx(0.0, abs=1e-9)
        turned = q + 0.1 * np.eye(6)[collision.joint_names.index("wrist_roll")]
        assert not wanted.holds(turned)
        assert wanted.deviation(turned).orientation_rad == pytest.approx(0.1, abs=1e-6)


def test_directions_are_taken_as_unit_vectors(forward, collision):
    pose = pose_of(forward, HOME)
    axis = constraints.rotation(pose.orientation)[:, 2]
    goal = AxisGoal(TIP, pose.position_m, 0.001, (0.0, 0.0, 1.0005), tuple(0.9995 * axis), 0.01)
    assert ConditionSet(forward, goal_conditions(goal, collision).required).holds(HOME)


def test_free_axes_of_an_orientation_are_not_aimed_at(collision):
    for tolerance_rad, kinds in (
        ((0.1, 0.1, 0.1), [TurnCondition]),
        ((0.1, 0.1, 3.15), [AxisCondition]),
        ((0.1, 4.0, 4.0), [TurnCondition]),
        ((4.0, 4.0, 4.0), []),
    ):
        orientation = OrientationConstraint(TIP, (0.0, 0.0, 0.0, 1.0), tolerance_rad)
        found = conditions(Constraints(orientations=(orientation,)), collision)
        assert [type(condition) for condition in found] == kinds, tolerance_rad


def test_joint_range_ends_at_the_joints_limits_and_a_weight_that_nobody_set_counts_as_one(condition_set, collision):
    column = collision.joint_names.index("elbow_flex")
    upper = collision.upper_rad[column]
    wanted = condition_set(joints=(JointConstraint("elbow_flex", upper, 0.5, 0.1),))
    assert wanted.holds(upper * np.eye(6)[column])
    assert not wanted.holds((upper + 0.01) * np.eye(6)[column])
    constraint = JointConstraint("elbow_flex", 0.0, 0.1, 0.1, weight=0.0)
    assert conditions(Constraints(joints=(constraint,)), collision)[0].weight == 1.0


def test_violations_name_what_and_by_how_much(condition_set):
    wanted = condition_set(
        joints=(JointConstraint("elbow_flex", 0.5, 0.1, 0.1),),
        positions=(PositionConstraint(TIP, Pose((0.3913, 0.0, 0.2264 + 0.05)), radius_m=0.03),),
    )
    joint, position = wanted.violations(HOME)
    assert joint.sentence == "joint 'elbow_flex' is at 0 rad, outside 0.4 to 0.6 rad"
    assert joint.details["lower_rad"] == pytest.approx(0.4)
    assert "2.0 cm outside" in position.sentence
    assert position.details["beyond_m"] == pytest.approx(0.02, abs=1e-3)
