import numpy as np
import pytest

from planners.geometry.nearness import NearPair
from planners.servo.question import ServoQuestion, ServoStatus, TipTwist
from planners.servo.report import Outcome, answer_of
from planners.servo.walls import Walls

NAMES = ("a", "b")
TABLE = NearPair("hand", "table", True, 0.012, np.zeros(2))
AROUND = Walls(np.zeros((5, 2)), np.zeros(5), [TABLE])
NONE, LIMIT_OF_B, NEAR_TABLE = np.array([], dtype=int), np.array([3]), np.array([4])


def told(active=NONE, had=(0.1, 0.0, 0.0), angular=(0.0, 0.0, 0.0), **more):
    question = ServoQuestion("arm", "tip", {}, {}, 0.02, TipTwist((0.1, 0.0, 0.0), angular))
    outcome = Outcome(np.array([0.3, 0.4]), active, np.array([0.1, 0.0, 0.0]), np.array(had), **more)
    return answer_of(question, NAMES, outcome, AROUND)


def test_what_is_had_whole_is_told_without_a_word():
    answer = told()
    assert (answer.status, answer.message, answer.share) == (ServoStatus.NO_WARNING, "", pytest.approx(1.0))
    assert answer.velocity_rad_s == {"a": 0.3, "b": 0.4}


def test_joints_at_their_limits_are_named():
    answer = told(LIMIT_OF_B)
    assert answer.status is ServoStatus.JOINT_BOUND
    assert answer.message.startswith("b at the limit")


@pytest.mark.parametrize(
    ("had", "status"),
    [
        ((0.05, 0.0, 0.0), ServoStatus.DECELERATE_FOR_COLLISION),
        ((0.0, 0.02, 0.0), ServoStatus.HALT_FOR_COLLISION),
    ],
)
def test_things_in_the_way_are_named_with_their_distance(had, status):
    answer = told(NEAR_TABLE, had)
    assert answer.status is status
    assert "hand and table (12 mm)" in answer.message


def test_of_several_the_gravest_is_the_status_and_all_are_told():
    both = np.union1d(LIMIT_OF_B, NEAR_TABLE)
    answer = told(both, (0.0, 0.0, 0.0), singularity=ServoStatus.HALT_FOR_SINGULARITY)
    assert answer.status is ServoStatus.HALT_FOR_COLLISION
    assert all(word in answer.message for word in ("limit", "singularity", "table"))


def test_a_turn_that_is_given_up_is_told_with_how_much_of_it():
    turn = {"wanted_turn_rad_s": np.array([0.0, 0.0, 0.5]), "turn_rad_s": np.array([0.0, 0.0, 0.2])}
    assert "0.30 rad/s are given up" in told(angular=(0.0, 0.0, 0.5), **turn).message


def test_an_orientation_that_is_not_kept_is_told_in_degrees():
    assert "10 degrees off" in told(drift_rad=np.radians(10.0)).message


def test_motion_against_the_wish_counts_as_none():
    assert told(had=(-0.1, 0.0, 0.0)).share == 0.0
