import math

import numpy as np
import pytest

from planners.budget import Budget
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
from planners.ik.constraints import ConditionSet, goal_conditions
from planners.ik.goal_states import DISTINCT_RAD, MAX_SOLUTIONS, GoalQuery, GoalStates
from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Box, Pose, SceneObject
from tests.planners.ik.test_constraints import pose_of
from tests.planners.invariants import never
from tests.planners.scenes import scene

TIP = "gripper_frame_link"
HOME = np.zeros(6)


def query(arm, should_stop=never, constraints=None, **options):
    return GoalQuery(arm, HOME, constraints, Budget(lambda: 0.0, 5.0, should_stop), **options)


@pytest.fixture(scope="module")
def free_states(collision):
    states = np.random.default_rng(5).uniform(collision.lower_rad, collision.upper_rad, (24, 6))
    states[:, collision.joint_names.index("gripper")] = 0.0
    return [q for q in states if not collision.in_collision(q)]


def axis_goal(goal_states, q):
    pose = pose_of(goal_states.forward, q)
    direction = goal_states.forward.placement(TIP).rotation[:, 2]
    return AxisGoal(TIP, pose.position_m, 0.001, (0.0, 0.0, 1.0), tuple(direction), 0.05)


@pytest.mark.parametrize(
    "goal_at",
    [
        lambda goal_states, q: PositionGoal(TIP, pose_of(goal_states.forward, q).position_m, 0.001),
        lambda goal_states, q: PoseGoal(TIP, pose_of(goal_states.forward, q), 0.001, (0.02, 0.02, 0.02), strict=True),
        axis_goal,
    ],
    ids=["position", "pose", "axis"],
)
def test_the_pose_of_a_free_state_is_reached_free_and_within_limits(goal_states, collision, arm, free_states, goal_at):
    for state in free_states:
        wanted = goal_conditions(goal_at(goal_states, state), collision)
        found = goal_states.search(wanted, query(arm))
        assert found.solutions, state
        for q in found.solutions:
            assert ConditionSet(goal_states.forward, wanted.required).holds(q)
            assert not collision.colliding_pairs(q)
            assert np.all((q >= collision.lower_rad) & (q <= collision.upper_rad))


def test_solutions_differ_and_the_soonest_comes_first(goal_states, arm, collision, free_states):
    for state in free_states[:20]:
        goal = PositionGoal(TIP, pose_of(goal_states.forward, state).position_m, 0.001)
        solutions = goal_states.search(goal_conditions(goal, collision), query(arm)).solutions
        times_s = [goal_states._move_time_s(HOME, q) for q in solutions]
        assert times_s == sorted(times_s)
        assert len(solutions) <= MAX_SOLUTIONS
        for i, q in enumerate(solutions):
            assert all(np.max(np.abs(q - other)) >= DISTINCT_RAD for other in solutions[:i])


def test_nearest_orientation_is_as_near_as_sampling_finds_it(goal_states, arm, collision, free_states):
    rng = np.random.default_rng(7)
    target_m = np.array([0.25, 0.1, 0.15])
    wanted = goal_conditions(
        PoseGoal(TIP, Pose(tuple(target_m), (0.5, 0.5, 0.5, 0.5)), 0.001, (0.02, 0.02, 0.02)), collision
    )
    found = goal_states.search(wanted, query(arm))
    preferred = ConditionSet(goal_states.forward, wanted.preferred)
    states = rng.uniform(collision.lower_rad, collision.upper_rad, (30_000, 6))
    near = np.linalg.norm(goal_states.forward.placements(states, TIP).positions_m - target_m, axis=1) < 0.02
    sampled = min(preferred.deviation(q).orientation_rad for q in states[near] if not collision.in_collision(q))
    assert preferred.deviation(found.solutions[0]).orientation_rad <= sampled + 0.1


def test_point_out_of_reach_has_a_nearest_configuration_that_is_free_and_nearly_best(goal_states, arm, collision):
    rng = np.random.default_rng(8)
    states = rng.uniform(collision.lower_rad, collision.upper_rad, (20_000, 6))
    positions_m = goal_states.forward.placements(states, TIP).positions_m
    for target_m in ((0.1, 0.0, 0.15), (0.6, 0.2, 0.3), (0.0, 0.7, 0.1)):
        found = goal_states.search(goal_conditions(PositionGoal(TIP, target_m, 0.001), collision), query(arm))
        order = np.argsort(np.linalg.norm(positions_m - target_m, axis=1))
        best = next(i for i in order if not collision.in_collision(states[i]))
        assert not found.solutions
        assert not collision.in_collision(found.nearest_q)
        assert found.nearest.position_m <= np.linalg.norm(positions_m[best] - target_m) + 0.002


def test_contacts_do_not_matter_when_they_are_not_minded(goal_states, arm, collision):
    wanted = goal_conditions(PositionGoal(TIP, (0.0, 0.0, 0.02), 0.01), collision)
    assert goal_states.search(wanted, query(arm)).colliding
    assert goal_states.search(wanted, query(arm, avoid_collisions=False)).solutions


TIP_AT_HOME = (0.3914, 0.0, 0.2264)


@pytest.fixture
def find(goal_states, arm):
    def ask(goal, **options):
        return goal_states.find(goal, query(arm, **options))

    return ask


def test_joint_goal_within_its_tolerance_beyond_a_limit_is_at_the_limit(find, collision):
    column = collision.joint_names.index("wrist_roll")
    (state,) = find(JointGoal({"wrist_roll": collision.upper_rad[column] + 5e-5}))
    assert state.q[column] == collision.upper_rad[column]


def test_strict_pose_on_five_joints_is_refused_with_its_error_in_degrees(find):
    point = Pose((0.25, 0.1, 0.15))
    failure = find(PoseGoal(TIP, point, 0.001, (0.01, 0.01, 0.01), strict=True))
    nearest = find(PoseGoal(TIP, point, 0.001, (0.01, 0.01, 0.01)))[0].deviation.orientation_rad
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert failure.details["orientation_rad"] == pytest.approx(nearest, abs=0.05)
    assert f"{math.degrees(failure.details['orientation_rad']):.1f}°" in failure.message


def test_a_point_out_of_reach_comes_with_the_configuration_that_has_the_nearest_one(find, arm, collision):
    failure = find(PositionGoal(TIP, (0.6, 0.0, 0.3), 0.001))
    nearest_rad = failure.details["nearest_rad"]
    assert list(nearest_rad) == list(arm.joints)
    q = np.array([nearest_rad.get(name, 0.0) for name in collision.joint_names])
    np.testing.assert_allclose(collision.tip_positions([q], TIP)[0], failure.details["nearest_m"], atol=1e-3)


def test_a_search_that_is_stopped_names_the_nearest_point_so_far(find):
    failure = find(PositionGoal(TIP, (0.6, 0.0, 0.3), 0.001), should_stop=lambda: True)
    assert failure.code is MoveItErrorCode.PREEMPTED
    assert "the nearest point so far is" in failure.message
    assert failure.details["distance_m"] > 0.1


def test_states_of_all_alternatives_are_sorted_by_time(find):
    states = find(AnyOf((PositionGoal(TIP, (0.0, 0.3, 0.2), 0.001), JointGoal({"wrist_roll": 0.2}))))
    assert states[0].q[4] == 0.2
    assert len(states) > 1


def test_alternatives_of_which_none_can_be_had_are_refused_together(find):
    failure = find(AnyOf((PositionGoal(TIP, (2.0, 0.0, 0.2), 0.001), PositionGoal(TIP, (0.0, 0.0, 0.02), 0.01))))
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert [other["code"] for other in failure.details["alternatives"]] == [-31, -12]


def test_states_found_for_a_constraint_goal_meet_it(find, collision):
    constraints = Constraints(
        joints=(JointConstraint("wrist_roll", 0.5, 0.05, 0.05),),
        positions=(PositionConstraint(TIP, Pose((0.25, 0.1, 0.2)), half_size_m=(0.05, 0.05, 0.01)),),
    )
    for state in find(ConstraintGoal(constraints)):
        assert abs(state.q[collision.joint_names.index("wrist_roll")] - 0.5) <= 0.051
        assert np.all(np.abs(collision.tip_positions([state.q], TIP)[0] - (0.25, 0.1, 0.2)) <= (0.0501, 0.0501, 0.0101))


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
    assert len(find(goal, accept_start=False)) > 1


def test_object_in_the_goal_is_named(robot, changing, arm):
    states = GoalStates(robot, changing)
    mug = SceneObject("mug", ((Box((0.08, 0.08, 0.08)), Pose()),), Pose((0.25, 0.1, 0.15)))
    assert changing.set_scene(scene(mug)) is None
    failure = states.find(PositionGoal(TIP, (0.25, 0.1, 0.15), 0.001), query(arm))
    assert isinstance(failure, PlanningFailure)
    assert failure.code is MoveItErrorCode.GOAL_IN_COLLISION
    assert "mug" in failure.message
    assert "mug" in {pair[side] for pair in failure.details["pairs"] for side in ("first", "second")}
