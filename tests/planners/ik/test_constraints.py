import numpy as np
import pinocchio as pin
import pytest

from planners.goals import (
    AxisGoal,
    ConstraintGoal,
    Constraints,
    JointConstraint,
    OrientationConstraint,
    PoseGoal,
    PositionConstraint,
    PositionGoal,
)
from planners.ik.conditions import AxisCondition, TurnCondition
from planners.ik.constraints import ConditionSet, conditions, rotation, wish
from planners.scene import Pose

TIP = "gripper_frame_link"
HOME = np.zeros(6)


@pytest.fixture
def forward(goal_states):
    return goal_states.forward


@pytest.fixture
def condition_set(forward, joints):
    def make(**parts):
        return ConditionSet(forward, conditions(Constraints(**parts), joints))

    return make


def pose_of(forward, q, link=TIP):
    forward.place(q)
    values = pin.SE3ToXYZQUAT(forward.placement(link)).tolist()
    return Pose(tuple(values[:3]), tuple(values[3:]))


def test_nothing_demanded_holds_everywhere(condition_set):
    assert condition_set().holds(HOME)
    assert condition_set().beyond_m(HOME) == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_a_pose_of_a_configuration_holds_there_and_not_elsewhere(forward, joints, collision, seed):
    q = np.random.default_rng(seed).uniform(collision.lower_rad, collision.upper_rad)
    goal = PoseGoal(TIP, pose_of(forward, q), 0.01, (0.05, 0.05, 0.05), strict=True)
    wanted = ConditionSet(forward, wish(goal, joints).required)
    assert wanted.holds(q)
    assert wanted.deviation(q).position_m == pytest.approx(0.0, abs=1e-9)
    turned = q + 0.1 * np.eye(6)[collision.joint_names.index("wrist_roll")]
    assert not wanted.holds(turned)
    assert wanted.deviation(turned).orientation_rad == pytest.approx(0.1, abs=1e-6)


def test_orientation_is_only_preferred_unless_the_pose_is_strict(joints):
    goal = PoseGoal(TIP, Pose((0.3, 0.0, 0.2)), 0.01, (0.05, 0.05, 0.05))
    assert [type(c) for c in wish(goal, joints).preferred] == [TurnCondition]
    assert len(wish(goal, joints).required) == 1


def test_goal_of_a_point_is_measured_at_its_offset(forward, joints):
    forward.place(HOME)
    placement = forward.placement(TIP)
    offset_m = np.array([0.01, 0.02, 0.03])
    target_m = placement.translation + placement.rotation @ offset_m
    goal = PositionGoal(TIP, tuple(target_m), 0.001, tuple(offset_m))
    assert ConditionSet(forward, wish(goal, joints).required).holds(HOME)


def test_directions_are_taken_as_unit_vectors(forward, joints):
    pose = pose_of(forward, HOME)
    axis = rotation(pose.orientation)[:, 2]
    goal = AxisGoal(TIP, pose.position_m, 0.001, (0.0, 0.0, 1.0005), tuple(0.9995 * axis), 0.01)
    assert ConditionSet(forward, wish(goal, joints).required).holds(HOME)


@pytest.mark.parametrize(
    ("tolerance_rad", "kinds"),
    [
        ((0.1, 0.1, 0.1), [TurnCondition]),
        ((0.1, 0.1, 3.15), [AxisCondition]),
        ((0.1, 4.0, 4.0), [TurnCondition]),
        ((4.0, 4.0, 4.0), []),
    ],
)
def test_free_axes_of_an_orientation_are_not_aimed_at(joints, tolerance_rad, kinds):
    orientation = OrientationConstraint(TIP, (0.0, 0.0, 0.0, 1.0), tolerance_rad)
    found = conditions(Constraints(orientations=(orientation,)), joints)
    assert [type(condition) for condition in found] == kinds


def test_joint_range_ends_at_the_joints_limits(condition_set, joints):
    column = joints.names.index("elbow_flex")
    upper = joints.upper_rad[column]
    wanted = condition_set(joints=(JointConstraint("elbow_flex", upper, 0.5, 0.1),))
    assert wanted.holds(upper * np.eye(6)[column])
    assert not wanted.holds((upper + 0.01) * np.eye(6)[column])


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


def test_weight_that_nobody_set_counts_as_one(joints):
    constraint = JointConstraint("elbow_flex", 0.0, 0.1, 0.1, weight=0.0)
    assert conditions(Constraints(joints=(constraint,)), joints)[0].weight == 1.0


def test_goal_of_constraints_demands_them_all(joints):
    constraints = Constraints(
        joints=(JointConstraint("elbow_flex", 0.5, 0.1, 0.1),),
        positions=(PositionConstraint(TIP, Pose((0.3, 0.0, 0.2)), half_size_m=(0.1, 0.1, 0.1)),),
        orientations=(OrientationConstraint(TIP, (0.0, 0.0, 0.0, 1.0), (0.1, 0.1, 0.1)),),
    )
    assert len(wish(ConstraintGoal(constraints), joints).required) == 3
