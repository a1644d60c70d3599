import numpy as np
import pytest

from planners.geometry.nearness import NearPair
from planners.servo.question import ServoLimits
from planners.servo.velocity_limits import APPROACH_PER_S, CURVATURE_M, velocity_bounds, within_reach

LOWER, UPPER = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
COLUMNS = np.array([0, 1])
TABLE = NearPair("hand", "table", True, 0.025, np.array([-0.2, 0.0, 9.0]))
ELBOW = NearPair("hand", "base", False, 0.013, np.array([0.0, 0.1, 9.0]))
PERIOD_S = 0.02
MAX_CHANGE = np.full(2, 4.0 * PERIOD_S)
LIMITS = ServoLimits(self_distance_m=0.003, scene_distance_m=0.005)


def bounds_there(q, pairs=(), limits=LIMITS):
    return velocity_bounds(np.array(q), LOWER, UPPER, COLUMNS, pairs, limits, MAX_CHANGE, PERIOD_S)


def test_rest_is_always_allowed_even_beyond_a_limit_or_in_contact():
    touching = NearPair("hand", "table", True, -0.01, np.array([-0.2, 0.0, 9.0]))
    assert (bounds_there([1.2, 0.0], [touching]).bounds >= 0.0).all()


def test_a_joint_nears_its_limit_ever_slower_and_leaves_it_freely():
    found = bounds_there([0.9, 0.0])
    fastest = found.bounds[found.rows[:, 0] == 1.0]
    back = found.bounds[found.rows[:, 0] == -1.0]
    assert fastest == pytest.approx([0.1 * APPROACH_PER_S])
    assert back == pytest.approx([1.9 * APPROACH_PER_S], rel=0.5)


def test_a_thing_is_neared_ever_slower_and_left_freely():
    found = bounds_there([0.0, 0.0], [TABLE])
    nearing, leaving = np.array([1.0, 0.0]), np.array([-1.0, 0.0])
    assert found.bounds[-1] == pytest.approx((0.02 - CURVATURE_M) * APPROACH_PER_S)
    assert found.rows[-1] @ nearing == pytest.approx(0.2)
    assert found.rows[-1] @ leaving < 0.0


def test_pairs_of_links_and_objects_keep_distances_of_their_own_or_none():
    assert len(bounds_there([0.0, 0.0], [TABLE, ELBOW]).pairs) == 2
    assert list(bounds_there([0.0, 0.0], [TABLE, ELBOW], ServoLimits(self_distance_m=None)).pairs) == [TABLE]
    assert list(bounds_there([0.0, 0.0], [TABLE, ELBOW], ServoLimits(scene_distance_m=None)).pairs) == [ELBOW]


def test_inequalities_are_told_apart_by_what_they_are_about():
    found = bounds_there([0.0, 0.0], [TABLE, ELBOW])
    assert found.joints(np.array([1, 3, 5])) == [1]
    assert found.near(np.array([1, 3, 5])) == [ELBOW]


def test_from_the_greatest_speed_of_approach_the_joints_brake_within_the_room_left():
    for room in (0.01, 0.05, 0.3, 1.0):
        found = bounds_there([1.0 - room, 0.0])
        speed, way = float(found.bounds[0]), 0.0
        while speed > 0.0:
            way += speed * PERIOD_S
            speed -= float(MAX_CHANGE[0])
        assert way <= room + 1e-9


REACH = np.array([0.1, 0.1])


def test_a_change_within_the_inequalities_is_made_as_it_is_wanted():
    wanted = np.array([0.1, -0.05])
    assert within_reach(wanted, REACH, np.eye(2), np.array([0.1, 0.1])) is wanted


@pytest.mark.parametrize("reversing", [-0.1, 0.0, 0.1])
def test_a_joint_that_reverses_does_not_hold_up_the_braking_of_another(reversing):
    """The first joint is to brake by all that it can; by a common share of the change it would brake by less."""
    change = within_reach(np.array([-0.02, reversing]), REACH, np.array([[1.0, 0.0]]), np.array([-0.1]))
    assert change == pytest.approx([-0.1, reversing], abs=0.01)


def test_what_cannot_be_met_in_one_step_is_come_as_near_to_as_possible():
    change = within_reach(np.zeros(2), REACH, np.array([[1.0, 1.0]]), np.array([-5.0]))
    assert change == pytest.approx([-0.1, -0.1], abs=0.01)


def test_a_joint_out_of_reach_is_left_alone():
    change = within_reach(np.zeros(2), np.array([0.1, 0.0]), np.array([[1.0, 1.0]]), np.array([-5.0]))
    assert change == pytest.approx([-0.1, 0.0], abs=0.01)
