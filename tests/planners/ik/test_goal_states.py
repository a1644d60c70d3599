import math
import time

import numpy as np
import pytest

from planners.budget import Budget
from planners.geometry.collision import CollisionModel
from planners.goals import (
    AnyOf,
    AxisGoal,
    ConstraintGoal,
    Constraints,
    JointConstraint,
    JointGoal,
    PoseGoal,
    PositionConstraint,
    PositionGoal,
)
from planners.ik.goal_states import Asker, GoalStates
from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Box, Pose, Scene, SceneObject
from tests.planners.ik.test_constraints import pose_of
from tests.planners.invariants import never

TIP = "gripper_frame_link"
HOME = np.zeros(6)
TIP_AT_HOME = (0.3914, 0.0, 0.2264)


@pytest.fixture
def find(goal_states, arm):
    def ask(goal, **options):
        budget = Budget(time.monotonic, 5.0, options.pop("should_stop", never))
        return goal_states.find(goal, Asker(arm, HOME, options.pop("constraints", None), budget, **options))

    return ask


def test_joint_goal_is_met_exactly_and_other_joints_stay(find, joints):
    (state,) = find(JointGoal({"elbow_flex": 0.7}))
    np.testing.assert_array_equal(state.q, 0.7 * np.eye(6)[joints.names.index("elbow_flex")])


def test_joint_goal_within_its_tolerance_beyond_a_limit_is_at_the_limit(find, joints):
    column = joints.names.index("wrist_roll")
    (state,) = find(JointGoal({"wrist_roll": joints.upper_rad[column] + 5e-5}))
    assert state.q[column] == joints.upper_rad[column]


def test_pose_on_five_joints_is_at_its_point_with_the_orientations_deviation_told(find, collision):
    states = find(PoseGoal(TIP, Pose((0.25, 0.1, 0.15)), 0.001, (0.01, 0.01, 0.01)))
    for state in states:
        assert np.linalg.norm(collision.tip_positions([state.q], TIP)[0] - (0.25, 0.1, 0.15)) <= 0.001
        assert state.deviation.position_m <= 0.001
        assert 0.01 < state.deviation.orientation_rad < math.pi


def test_strict_pose_on_five_joints_is_refused_with_its_error_in_degrees(find):
    point = Pose((0.25, 0.1, 0.15))
    failure = find(PoseGoal(TIP, point, 0.001, (0.01, 0.01, 0.01), strict=True))
    nearest = find(PoseGoal(TIP, point, 0.001, (0.01, 0.01, 0.01)))[0].deviation.orientation_rad
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert failure.details["orientation_rad"] == pytest.approx(nearest, abs=0.05)
    assert f"{math.degrees(failure.details['orientation_rad']):.1f}°" in failure.message


def test_a_point_out_of_reach_comes_with_the_configuration_that_has_the_nearest_one(find, arm, collision, joints):
    failure = find(PositionGoal(TIP, (0.6, 0.0, 0.3), 0.001))
    nearest_rad = failure.details["nearest_rad"]
    assert list(nearest_rad) == list(arm.joints)
    q = np.array([nearest_rad.get(name, 0.0) for name in joints.names])
    np.testing.assert_allclose(collision.tip_positions([q], TIP)[0], failure.details["nearest_m"], atol=1e-3)


def test_strict_pose_that_can_be_had_is_had(find, goal_states):
    q = np.array([0.4, -0.3, 0.6, 0.5, 0.2, 0.0])
    goal = PoseGoal(TIP, pose_of(goal_states.forward, q), 0.001, (0.01, 0.01, 0.01), strict=True)
    assert all(state.deviation.orientation_rad < 0.018 for state in find(goal))


def test_axis_goal_says_how_far_off_the_axis_is(find):
    failure = find(AxisGoal(TIP, (0.4, 0.0, 0.3), 0.001, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), 0.05))
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert "°" in failure.message


def test_alternatives_are_sorted_by_time_and_told_apart(find):
    states = find(AnyOf((PositionGoal(TIP, (0.0, 0.3, 0.2), 0.001), JointGoal({"wrist_roll": 0.2}))))
    assert states[0].alternative == 1
    assert {state.alternative for state in states} == {0, 1}


def test_alternative_that_cannot_be_had_is_left_out(find):
    states = find(AnyOf((PositionGoal(TIP, (2.0, 0.0, 0.2), 0.001), JointGoal({"wrist_roll": 0.2}))))
    assert [state.alternative for state in states] == [1]


def test_alternatives_of_which_none_can_be_had_are_refused_together(find):
    failure = find(AnyOf((PositionGoal(TIP, (2.0, 0.0, 0.2), 0.001), PositionGoal(TIP, (0.0, 0.0, 0.02), 0.01))))
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert [other["code"] for other in failure.details["alternatives"]] == [-31, -12]


def test_constraint_goal_holds_where_it_is_met(find, joints, collision):
    constraints = Constraints(
        joints=(JointConstraint("wrist_roll", 0.5, 0.05, 0.05),),
        positions=(PositionConstraint(TIP, Pose((0.25, 0.1, 0.2)), half_size_m=(0.05, 0.05, 0.01)),),
    )
    for state in find(ConstraintGoal(constraints)):
        assert abs(state.q[joints.names.index("wrist_roll")] - 0.5) <= 0.051
        assert np.all(np.abs(collision.tip_positions([state.q], TIP)[0] - (0.25, 0.1, 0.2)) <= (0.0501, 0.0501, 0.0101))


def test_goal_of_joint_constraints_alone_is_at_their_positions(find, joints):
    column = joints.names.index("elbow_flex")
    states = find(ConstraintGoal(Constraints(joints=(JointConstraint("elbow_flex", 0.5, 0.01, 0.01),))))
    assert states[0].q[column] == pytest.approx(0.5, abs=2e-3)


def test_constraints_that_contradict_each_other_are_refused_with_what_does_not_hold(find):
    constraints = Constraints(
        positions=(
            PositionConstraint(TIP, Pose((0.3, 0.0, 0.2)), radius_m=0.01),
            PositionConstraint(TIP, Pose((0.3, 0.0, 0.3)), radius_m=0.01),
        )
    )
    failure = find(ConstraintGoal(constraints))
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert len(failure.details["violations"]) == 2


def test_goal_outside_the_path_constraints_violates_them(find):
    left = Constraints(positions=(PositionConstraint(TIP, Pose((0.3, 0.5, 0.2)), half_size_m=(0.5, 0.5, 0.5)),))
    for goal in (PositionGoal(TIP, (0.25, -0.2, 0.2), 0.01), JointGoal({"shoulder_pan": 0.8})):
        failure = find(goal, constraints=left)
        assert failure.code is MoveItErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS
        assert TIP in failure.message


def test_start_counts_unless_told_otherwise(find):
    goal = PositionGoal(TIP, TIP_AT_HOME, 0.01)
    assert [state.q is HOME for state in find(goal)] == [True]
    assert len(find(goal, start_counts=False)) > 1


def test_object_in_the_goal_is_named(robot, arm):
    collision = CollisionModel(robot)
    states = GoalStates(robot, collision)
    mug = SceneObject("mug", ((Box((0.08, 0.08, 0.08)), Pose()),), Pose((0.25, 0.1, 0.15)))
    assert collision.set_scene(Scene(1, (mug,))) is None
    asker = Asker(arm, HOME, None, Budget(time.monotonic, 5.0, never))
    failure = states.find(PositionGoal(TIP, (0.25, 0.1, 0.15), 0.001), asker)
    assert isinstance(failure, PlanningFailure)
    assert failure.code is MoveItErrorCode.GOAL_IN_COLLISION
    assert "mug" in failure.message
    assert "mug" in {pair[side] for pair in failure.details["pairs"] for side in ("first", "second")}


def test_stopped_search_is_preempted(find):
    failure = find(PositionGoal(TIP, (0.0, 0.0, 2.0), 0.01), should_stop=lambda: True)
    assert failure.code is MoveItErrorCode.PREEMPTED
