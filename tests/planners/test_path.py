import numpy as np
import pytest

from planners.joint_space import CHECK_STEP_M, JointSpace, coarse_to_fine
from planners.path import search, shortcut
from tests.planners.invariants import BLOCKED_LINES, never

HOME = np.zeros(5)
READY = np.array([0.0, -0.5, 0.5, 0.0, 0.0])
FINE_STEP_M = 0.5 * CHECK_STEP_M


@pytest.fixture(params=BLOCKED_LINES)
def blocked(request):
    return tuple(np.array(point) for point in request.param)


def length(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()


def test_line_through_open_space_is_free(joint_space):
    assert joint_space.line_free(HOME, READY)


def test_line_through_the_arm_itself_is_blocked_both_ways(joint_space, blocked):
    start, goal = blocked
    assert joint_space.free(start)
    assert joint_space.free(goal)
    assert not joint_space.line_free(start, goal)
    assert not joint_space.line_free(goal, start)


@pytest.mark.parametrize("step_m", [0.001, 0.005, 0.05])
def test_checks_of_a_curve_are_no_further_apart_than_the_step(joint_space, collision, step_m, monkeypatch):
    corners = np.array([[0.0] * 5, [1.0, -0.5, 0.3, 0.0, 2.0], [0.9, -0.5, 0.3, 0.0, 2.0], [0.9, 0.0, 0.0, 0.0, 0.0]])
    checked = []
    monkeypatch.setattr(joint_space, "free", lambda point: checked.append(point) is None)
    assert joint_space.curve_free(corners, step_m)
    total_m = (np.abs(np.diff(corners, axis=0)) @ collision.travel_m_per_rad[:5]).sum()
    assert total_m / len(checked) <= step_m + 1e-12
    # Evenly along the curve: no two neighbours are further apart than their share of it.
    near_start = min(checked, key=lambda point: np.abs(point - corners[0]).sum())
    assert collision.travel_m_per_rad[:5] @ np.abs(near_start - corners[0]) == pytest.approx(total_m / len(checked))
    assert any(np.array_equal(point, corners[-1]) for point in checked)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 8, 9, 100])
def test_every_check_is_made_once_and_the_last_one_first(count):
    order = list(coarse_to_fine(count))
    assert order[0] == count
    assert sorted(order) == list(range(1, count + 1))


def test_curve_is_blocked_when_one_of_its_lines_is(joint_space, blocked):
    start, goal = blocked
    assert joint_space.curve_free(np.array([HOME, READY, HOME]))
    assert not joint_space.curve_free(np.array([HOME, start, goal]))


def test_joints_outside_the_group_count_where_they_stand(collision, arm):
    gripper = collision.joint_names.index("gripper")
    rng = np.random.default_rng(7)
    for q in rng.uniform(collision.lower_rad, collision.upper_rad, (200, 6)):
        start_q = np.zeros(6)
        start_q[gripper] = q[gripper]
        space = JointSpace(collision, arm, start_q)
        assert space.free(space.point(q)) == (not collision.in_collision(q))


def test_search_finds_a_free_path_from_start_to_goal(joint_space, blocked):
    path = search(joint_space, *_ends(blocked), seed=0, should_stop=never)
    np.testing.assert_array_equal(path[[0, -1]], blocked)
    assert joint_space.curve_free(path)
    assert np.all((path >= joint_space.lower_rad) & (path <= joint_space.upper_rad))


def test_search_ends_at_one_of_several_goals(joint_space, blocked):
    start, goal = blocked
    goals = [goal, goal + 0.01]
    path = search(joint_space, start, goals, seed=3, should_stop=never)
    assert any(np.array_equal(path[-1], each) for each in goals)


def test_same_seed_gives_the_same_path_and_another_seed_another(joint_space, blocked):
    start, goals = _ends(blocked)
    first, again, other = (search(joint_space, start, goals, seed, never) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert first.shape != other.shape or not np.array_equal(first, other)


def test_stopped_search_has_no_path(joint_space, blocked):
    assert search(joint_space, *_ends(blocked), seed=0, should_stop=lambda: True) is None


def test_search_stops_soon_after_it_is_asked_to(joint_space):
    # A goal in collision can never be reached.
    inside = np.array([0.0, -1.745, 1.69, 1.0, 0.0])
    asked = iter(range(20))
    path = search(joint_space, HOME, [inside], 0, lambda: next(asked, None) is None)
    assert path is None


def test_shortcuts_keep_the_ends_and_only_shorten(joint_space):
    detour = np.array([HOME, [0.5, -0.2, 0.3, 0.1, 0.0], [-0.4, -0.6, 0.2, 0.0, 0.3], [0.3, 0.1, 0.4, 0.0, 0.0], READY])
    straight = shortcut(joint_space, detour, 0, never)
    np.testing.assert_array_equal(straight[[0, -1]], detour[[0, -1]])
    assert length(straight) < 0.6 * length(detour)
    assert joint_space.curve_free(straight, FINE_STEP_M)


def test_shortcuts_stop_when_asked_to(joint_space):
    detour = np.array([HOME, [0.5, -0.2, 0.3, 0.1, 0.0], READY])
    np.testing.assert_array_equal(shortcut(joint_space, detour, 0, lambda: True), detour)


def _ends(blocked):
    start, goal = blocked
    return start, [goal]
