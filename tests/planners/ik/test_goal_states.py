import math

import numpy as np
import pytest

from planners.budget import Budget
from planners.goals import AnyOf, AxisGoal, ConstraintGoal, Constraints, JointConstraint, JointGoal, PoseGoal
from planners.goals import PositionConstraint as Region
from planners.goals import PositionGoal as Point
from planners.ik.constraints import ConditionSet, goal_conditions
from planners.ik.goal_states import DISTINCT_RAD, MAX_SOLUTIONS, GoalQuery, GoalStates
from planners.problem import MoveItErrorCode as Code
from planners.scene import Box, Pose
from tests.planners.ik.test_kinematics import pose_of
from tests.planners.invariants import never
from tests.planners.scenes import scene, thing, tip_positions_m

TIP = "gripper_frame_link"
HOME = np.zeros(6)


def query(arm, should_stop=never, constraints=None, **options):
    return GoalQuery(arm, HOME, constraints, Budget(lambda: 0.0, 5.0, should_stop), **options)


@pytest.fixture(scope="module")
def free_states(collision):
    states = np.random.default_rng(5).uniform(collision.lower_rad, collision.upper_rad, (24, 6))
    states[:, collision.joint_names.index("gripper")] = 0.0
    return [q for q in states if not collision.in_collision(q)]


@pytest.fixture
def search(goal_states, arm, collision):
    return lambda goal, **options: goal_states.search(goal_conditions(goal, collision), query(arm, **options))


@pytest.fixture
def find(goal_states, arm):
    return lambda goal, **options: goal_states.find(goal, query(arm, **options))


@pytest.fixture
def goals_at(goal_states):
    def goals_at(q):
        """Goals of each kind at the pose of a state."""
        pose = pose_of(goal_states.forward, q)
        direction = tuple(goal_states.forward.placement(TIP).rotation[:, 2])
        return {
            "position": Point(TIP, pose.position_m, 0.001),
            "pose": PoseGoal(TIP, pose, 0.001, (0.02, 0.02, 0.02), strict=True),
            "axis": AxisGoal(TIP, pose.position_m, 0.001, (0.0, 0.0, 1.0), direction, 0.05),
        }

    return goals_at


@pytest.mark.parametrize("kind", ["position", "pose", "axis"])
def test_the_pose_of_a_free_state_is_reached_by_free_solutions(
    goal_states, collision, free_states, search, goals_at, kind
):
    for state in free_states:
        goal = goals_at(state)[kind]
        solutions, wanted = search(goal).solutions, goal_conditions(goal, collision).required
        assert 0 < len(solutions) <= MAX_SOLUTIONS, state
        for i, q in enumerate(solutions):
            assert ConditionSet(goal_states.forward, wanted).holds(q)
            assert not collision.colliding_pairs(q)
            assert np.all((q >= collision.lower_rad) & (q <= collision.upper_rad))
            assert all(np.max(np.abs(q - other)) >= DISTINCT_RAD for other in solutions[:i])
        times_s = [goal_states._move_time_s(HOME, q) for q in solutions]
        assert kind != "position" or times_s == sorted(times_s)


def test_the_nearest_orientation_or_point_is_free_and_as_near_as_sampling_finds_it(goal_states, collision, search):
    states = np.random.default_rng(8).uniform(collision.lower_rad, collision.upper_rad, (30_000, 6))
    positions_m = goal_states.forward.placements(states, TIP).positions_m
    target_m = np.array([0.25, 0.1, 0.15])
    goal = PoseGoal(TIP, Pose(tuple(target_m), (0.5, 0.5, 0.5, 0.5)), 0.001, (0.02, 0.02, 0.02))
    preferred = ConditionSet(goal_states.forward, goal_conditions(goal, collision).preferred)
    near = np.linalg.norm(positions_m - target_m, axis=1) < 0.02
    sampled = min(preferred.deviation(q).orientation_rad for q in states[near] if not collision.in_collision(q))
    assert preferred.deviation(search(goal).solutions[0]).orientation_rad <= sampled + 0.1
    for target_m in ((0.1, 0.0, 0.15), (0.6, 0.2, 0.3), (0.0, 0.7, 0.1)):
        found = search(Point(TIP, target_m, 0.001))
        order = np.argsort(np.linalg.norm(positions_m - target_m, axis=1))
        best = next(i for i in order if not collision.in_collision(states[i]))
        assert not found.solutions
        assert not collision.in_collision(found.nearest_q)
        assert found.nearest.position_m <= np.linalg.norm(positions_m[best] - target_m) + 0.002


def test_contacts_and_the_start_count_unless_told_otherwise_and_limits_always(search, find, collision):
    in_the_base = Point(TIP, (0.0, 0.0, 0.02), 0.01)
    assert search(in_the_base).colliding
    assert search(in_the_base, avoid_collisions=False).solutions
    column = collision.joint_names.index("wrist_roll")
    (state,) = find(JointGoal({"wrist_roll": collision.upper_rad[column] + 5e-5}))
    assert state.q[column] == collision.upper_rad[column]
    goal = Point(TIP, (0.3914, 0.0, 0.2264), 0.01)
    assert [state.q is HOME for state in find(goal)] == [True]
    assert len(find(goal, accept_start=False)) > 1


def test_strict_pose_on_five_joints_is_refused_with_its_error_in_degrees(find):
    pose, tolerance_rad = Pose((0.25, 0.1, 0.15)), (0.01, 0.01, 0.01)
    failure = find(PoseGoal(TIP, pose, 0.001, tolerance_rad, strict=True))
    nearest = find(PoseGoal(TIP, pose, 0.001, tolerance_rad))[0].deviation.orientation_rad
    assert failure.code is Code.NO_IK_SOLUTION
    assert failure.details["orientation_rad"] == pytest.approx(nearest, abs=0.05)
    assert f"{math.degrees(failure.details['orientation_rad']):.1f}°" in failure.message


def test_a_point_out_of_reach_comes_with_the_nearest_even_if_the_search_is_stopped(find, arm, collision):
    failure = find(Point(TIP, (0.6, 0.0, 0.3), 0.001))
    nearest_rad = failure.details["nearest_rad"]
    assert list(nearest_rad) == list(arm.joints)
    q = np.array([nearest_rad.get(name, 0.0) for name in collision.joint_names])
    np.testing.assert_allclose(tip_positions_m(collision, [q], TIP)[0], failure.details["nearest_m"], atol=1e-3)
    failure = find(Point(TIP, (0.6, 0.0, 0.3), 0.001), should_stop=lambda: True)
    assert failure.code is Code.PREEMPTED
    assert "the nearest point so far is" in failure.message
    assert failure.details["distance_m"] > 0.1


def test_states_of_all_alternatives_are_sorted_by_time_and_those_of_which_none_can_be_had_refused_together(find):
    states = find(AnyOf((Point(TIP, (0.0, 0.3, 0.2), 0.001), JointGoal({"wrist_roll": 0.2}))))
    assert states[0].q[4] == 0.2
    assert len(states) > 1
    failure = find(AnyOf((Point(TIP, (2.0, 0.0, 0.2), 0.001), Point(TIP, (0.0, 0.0, 0.02), 0.01))))
    assert failure.code is Code.NO_IK_SOLUTION
    assert [other["code"] for other in failure.details["alternatives"]] == [-31, -12]


def test_states_found_for_a_constraint_goal_meet_it_and_contradictions_are_refused(find, collision):
    region = Region(TIP, Pose((0.25, 0.1, 0.2)), half_size_m=(0.05, 0.05, 0.01))
    roll = JointConstraint("wrist_roll", 0.5, 0.05, 0.05)
    for state in find(ConstraintGoal(Constraints(joints=(roll,), positions=(region,)))):
        assert abs(state.q[collision.joint_names.index("wrist_roll")] - 0.5) <= 0.051
        away_m = np.abs(tip_positions_m(collision, [state.q], TIP)[0] - (0.25, 0.1, 0.2))
        assert np.all(away_m <= (0.0501, 0.0501, 0.0101))
    low, high = (Region(TIP, Pose((0.3, 0.0, z)), radius_m=0.01) for z in (0.2, 0.3))
    failure = find(ConstraintGoal(Constraints(positions=(low, high))))
    assert failure.code is Code.NO_IK_SOLUTION
    assert len(failure.details["violations"]) == 2


def test_goal_outside_the_path_constraints_violates_them_and_an_object_in_it_is_named(find, robot, changing, arm):
    left = Constraints(positions=(Region(TIP, Pose((0.3, 0.5, 0.2)), half_size_m=(0.5, 0.5, 0.5)),))
    for goal in (Point(TIP, (0.25, -0.2, 0.2), 0.01), JointGoal({"shoulder_pan": 0.8})):
        failure = find(goal, constraints=left)
        assert failure.code is Code.GOAL_VIOLATES_PATH_CONSTRAINTS
        assert TIP in failure.message
    states, wanted_m = GoalStates(robot, changing), (0.25, 0.1, 0.15)
    assert changing.set_scene(scene(thing(Box((0.08, 0.08, 0.08)), *wanted_m, name="mug"))) is None
    failure = states.find(Point(TIP, wanted_m, 0.001), query(arm))
    assert failure.code is Code.GOAL_IN_COLLISION
    assert "mug" in failure.message
    assert "mug" in {pair[side] for pair in failure.details["pairs"] for side in ("first", "second")}
