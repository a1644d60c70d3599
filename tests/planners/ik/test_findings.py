import numpy as np
import pytest

from planners.goals import PoseGoal, PositionGoal
from planners.ik.constraints import wish
from planners.ik.findings import DISTINCT_RAD, FRUITLESS_RESTARTS, HOPELESS_RESTARTS, Findings
from planners.scene import Pose

TIP = "gripper_frame_link"
HOME = np.zeros(6)
FOLDED = np.array([0.0, -1.7, 1.69, 1.2, 0.0, 0.0])
# Turning the last joint of the arm moves the tip by less than a millimetre.
ROLL = np.eye(6)[4]


def no_time(_):
    return 0.0


@pytest.fixture
def findings(goal_states, collision, joints):
    def make(center, tolerance_m=0.1):
        goal = PositionGoal(TIP, tuple(collision.tip_positions([center], TIP)[0]), tolerance_m)
        return Findings(goal_states.forward, collision, wish(goal, joints))

    return make


def test_ends_that_are_nearly_the_same_are_one_solution(findings):
    found = findings(HOME)
    for q in (HOME, HOME + 0.9 * DISTINCT_RAD * ROLL, HOME + 1.1 * DISTINCT_RAD * ROLL):
        found.add(q)
    assert len(found.result(no_time).solutions) == 2


def test_collision_is_told_only_where_no_solution_is_free(findings):
    found = findings(FOLDED, tolerance_m=1.0)
    found.add(FOLDED)
    assert found.result(no_time).colliding
    assert found.only_colliding
    found.add(HOME)
    assert not found.result(no_time).colliding
    assert not found.only_colliding


def test_what_can_be_had_only_with_a_contact_is_told_apart_from_what_is_out_of_reach(findings):
    touching, out_of_reach = findings(FOLDED, tolerance_m=1.0), findings(HOME + 0.5, tolerance_m=0.001)
    touching.add(FOLDED)
    out_of_reach.add(FOLDED)
    assert touching.only_touching
    assert not out_of_reach.only_touching
    touching.add(HOME)
    assert not touching.only_touching


def test_a_row_of_descents_is_as_patient_as_it_is_told(findings):
    hopeless = findings(HOME + 0.5, tolerance_m=0.001)
    hopeless.begin(patience=2 * HOPELESS_RESTARTS)
    for _ in range(2 * HOPELESS_RESTARTS):
        assert not hopeless.enough(wanted=6)
        hopeless.add(HOME)
    hopeless.add(HOME)
    assert hopeless.enough(wanted=6)


def test_nearest_is_free_even_if_one_in_contact_is_nearer(findings):
    found = findings(FOLDED, tolerance_m=0.001)
    found.add(FOLDED)
    found.add(HOME)
    assert found.result(no_time).nearest_q is HOME


def test_contacts_count_only_where_they_are_minded(goal_states, collision, joints):
    goal = PositionGoal(TIP, tuple(collision.tip_positions([FOLDED], TIP)[0]), 0.1)
    found = Findings(goal_states.forward, None, wish(goal, joints))
    found.add(FOLDED)
    assert len(found.result(no_time).solutions) == 1


def test_patience_ends_sooner_once_there_is_a_solution(findings):
    found, hopeless = findings(HOME), findings(HOME + 0.5, tolerance_m=0.001)
    found.add(HOME)
    hopeless.add(HOME)
    for _ in range(FRUITLESS_RESTARTS):
        found.add(HOME)
        hopeless.add(HOME)
    assert found.enough(wanted=6)
    assert not hopeless.enough(wanted=6)
    for _ in range(HOPELESS_RESTARTS):
        hopeless.add(HOME)
    assert hopeless.enough(wanted=6)


def test_of_preferences_only_the_best_met_stay(goal_states, collision, joints):
    forward = goal_states.forward
    forward.place(HOME)
    position_m = tuple(collision.tip_positions([HOME], TIP)[0])
    rotation = forward.placement(TIP).rotation
    goal = PoseGoal(TIP, Pose(position_m, tuple(_quaternion(rotation))), 0.05, (0.02, 0.02, 0.02))
    found = Findings(forward, collision, wish(goal, joints))
    found.add(HOME + 0.5 * ROLL)
    found.add(HOME)
    assert [q is HOME for q in found.result(no_time).solutions] == [True]


def _quaternion(rotation):
    w = 0.5 * np.sqrt(1.0 + np.trace(rotation))
    skew = rotation - rotation.T
    return *(np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / (4.0 * w)), w
