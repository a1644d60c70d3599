import numpy as np
import pytest

from planners.collision import CollisionModel
from planners.kinematics import DISTINCT_RAD, MAX_SOLUTIONS, PositionSolver, _Findings
from robot import model
from tests.planners.invariants import never
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF

TIP = "gripper_frame_link"
HOME = np.zeros(6)


@pytest.fixture
def reachable(collision):
    """Free configurations and where the tip is in them."""
    states = np.random.default_rng(5).uniform(collision.lower_rad, collision.upper_rad, (120, 6))
    free = np.array([q for q in states if not collision.in_collision(q)])
    return list(zip(free, collision.tip_positions(free, TIP), strict=True))


def test_every_reachable_point_has_a_free_solution_within_tolerance_and_limits(solver, collision, arm, reachable):
    for _, target_m in reachable:
        found = solver.solve_position(arm, target_m, TIP, HOME, 0.001, never)
        assert found.solutions
        for q in found.solutions:
            assert np.linalg.norm(collision.tip_position(q, TIP) - target_m) <= 0.001
            assert not collision.in_collision(q)
            assert np.all((q >= collision.lower_rad) & (q <= collision.upper_rad))


def test_solutions_differ_and_the_soonest_comes_first(solver, arm, reachable):
    for seed_q, target_m in reachable[:20]:
        found = solver.solve_position(arm, target_m, TIP, seed_q, 0.001, never)
        times_s = [solver.move_time_s(seed_q, q) for q in found.solutions]
        assert times_s == sorted(times_s)
        assert len(found.solutions) <= MAX_SOLUTIONS
        for i, q in enumerate(found.solutions):
            assert all(np.max(np.abs(q - other)) >= DISTINCT_RAD for other in found.solutions[:i])


def test_ends_of_descents_that_are_nearly_the_same_are_one_solution(collision):
    target_m = collision.tip_position(HOME, TIP)
    found = _Findings(collision, target_m, 0.1)
    for q in (HOME, HOME + 0.9 * DISTINCT_RAD * np.eye(6)[4], HOME + 1.1 * DISTINCT_RAD * np.eye(6)[4]):
        found.add(q, target_m)
    assert len(found.result(lambda q: 0.0).solutions) == 2


def test_a_joint_outside_the_group_is_not_used_to_get_nearer():
    srdf = CRANE_SRDF.replace('<chain base_link="foot" tip_link="rod"/>', '<joint name="turn"/><joint name="lift"/>')
    crane = model.parse(CRANE_URDF, srdf)
    collision = CollisionModel(crane)
    solver = PositionSolver(crane, collision)
    target_m = np.array([0.35, 0.0, 0.27])
    found = solver.solve_position(crane.groups["arm"], target_m, "rod", np.zeros(3), 0.001, never)
    assert found.solutions == ()
    assert found.distance_m == pytest.approx(0.05, abs=1e-3)
    assert found.nearest_q[collision.joint_names.index("slide")] == 0.0


def test_joints_outside_the_group_stay(solver, collision, arm):
    gripper = collision.joint_names.index("gripper")
    seed_q = HOME.copy()
    seed_q[gripper] = 0.7
    found = solver.solve_position(arm, np.array([0.3, 0.1, 0.2]), TIP, seed_q, 0.01, never)
    assert found.solutions
    assert all(q[gripper] == 0.7 for q in found.solutions)


def test_point_of_the_first_client_is_41_mm_from_the_nearest_reachable_one(solver, collision, arm):
    found = solver.solve_position(arm, np.array([0.1, 0.0, 0.15]), TIP, HOME, 0.01, never)
    assert found.solutions == ()
    assert found.colliding == ()
    assert found.distance_m == pytest.approx(0.041, abs=0.001)
    assert not collision.in_collision(found.nearest_q)
    np.testing.assert_allclose(collision.tip_position(found.nearest_q, TIP), found.nearest_m, atol=1e-9)


@pytest.mark.parametrize("target_m", [(0.05, 0.05, 0.9), (5.0, 0.0, 0.0), (-0.6, 0.1, 0.0), (0.02, 0.02, 0.3)])
def test_no_sampled_configuration_comes_nearer_than_the_nearest_one(solver, collision, arm, target_m):
    states = np.random.default_rng(6).uniform(collision.lower_rad, collision.upper_rad, (3000, 6))
    distances_m = np.linalg.norm(collision.tip_positions(states, TIP) - target_m, axis=1)
    nearer = [states[i] for i in np.argsort(distances_m)[:50]]
    sampled_m = min(
        float(np.linalg.norm(collision.tip_position(q, TIP) - target_m))
        for q in nearer
        if not collision.in_collision(q)
    )
    found = solver.solve_position(arm, np.array(target_m), TIP, HOME, 1e-4, never)
    assert found.distance_m <= sampled_m + 1e-3


def test_point_inside_the_arm_is_answered_with_the_links_that_touch(solver, arm):
    found = solver.solve_position(arm, np.array([0.0, 0.0, 0.02]), TIP, HOME, 0.01, never)
    assert found.solutions == ()
    assert "base_link" in {link for pair in found.colliding for link in pair.links}


def test_nearest_configuration_is_free_even_where_a_colliding_one_is_nearer(solver, collision, arm):
    inside_m = np.array([0.0, 0.0, 0.02])
    # No descent gets this near, so every end of one counts as out of reach.
    found = solver.solve_position(arm, inside_m, TIP, HOME, 1e-9, never)
    assert not collision.in_collision(found.nearest_q)


def test_same_question_has_the_same_answer_whatever_was_asked_before(solver, arm):
    def ask(target_m):
        return solver.solve_position(arm, np.array(target_m), TIP, HOME, 0.01, never)

    first = ask((0.25, -0.1, 0.2))
    ask((0.1, 0.0, 0.15))
    np.testing.assert_array_equal(first.solutions, ask((0.25, -0.1, 0.2)).solutions)


def test_stopped_search_answers_with_what_the_first_try_found(solver, arm):
    asked = []
    found = solver.solve_position(arm, np.array([0.1, 0.0, 0.15]), TIP, HOME, 0.01, lambda: not asked.append(1))
    assert np.isfinite(found.distance_m)
    assert len(asked) == 1


def test_a_seed_that_is_there_already_is_a_solution(solver, collision, arm):
    target_m = collision.tip_position(HOME, TIP)
    found = solver.solve_position(arm, target_m, TIP, HOME, 0.001, never)
    np.testing.assert_array_equal(found.solutions[0], HOME)
