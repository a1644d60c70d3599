from __future__ import annotations

import numpy as np
import pytest

from planners.geometry.certificate import encounter
from planners.geometry.collision import CollisionModel
from planners.pipeline import Planner
from planners.problem import ConcurrencyQuestion, MoveItErrorCode, PlanningFailure, RecheckAnswer
from robot.description import model
from robot.trajectory import Trajectory
from tests.helpers.motions import smooth_move
from tests.helpers.robots import LIFTED_SRDF, LIFTED_URDF, PAIR_SRDF, PAIR_URDF

PAIR = model.parse(PAIR_URDF, PAIR_SRDF)
ZERO = {joint.name: 0.0 for joint in PAIR.movable_joints}


@pytest.fixture(scope="module")
def pair() -> CollisionModel:
    return CollisionModel(PAIR)


def leaning(side: str, from_rad: float, to_rad: float) -> Trajectory:
    """An upright arm that leans over to the side, its first joint turned so that it leans along y."""
    return smooth_move({f"{side}_a1": (np.pi / 2, np.pi / 2), f"{side}_a2": (from_rad, to_rad)}, 2.0)


def test_motions_towards_each_other_touch(pair: CollisionModel) -> None:
    found = encounter(pair, leaning("left", 0.0, -1.5), leaning("right", 0.0, 1.5), ZERO)
    assert found is not None
    sides = {frozenset((pair.first[:4], pair.second[:4])) for pair in found.pairs}
    assert frozenset(("left", "righ")) in sides


def test_motions_that_use_the_same_place_at_different_times_touch(pair: CollisionModel) -> None:
    left, right = leaning("left", 0.0, -1.5), leaning("right", 1.5, 0.0)
    assert encounter(pair, left, right, ZERO) is not None


def test_every_pair_of_positions_of_motions_that_do_not_touch_is_free(pair: CollisionModel) -> None:
    left, right = leaning("left", 0.0, -0.55), leaning("right", 0.0, 0.55)
    assert encounter(pair, left, right, ZERO) is None
    for first_s in np.linspace(0.0, 2.0, 9):
        for second_s in np.linspace(0.0, 2.0, 9):
            at = dict(zip(left.joint_names, left.sample(first_s)[0], strict=True))
            at |= dict(zip(right.joint_names, right.sample(second_s)[0], strict=True))
            assert not pair.collides(np.array([at.get(name, 0.0) for name in pair.joint_names]))


def test_fingers_move_while_their_own_hand_does() -> None:
    robot = model.parse(LIFTED_URDF, LIFTED_SRDF)
    others = {joint.name: 0.0 for joint in robot.movable_joints}
    fingers = smooth_move({"left_finger_joint": (0.0, 0.05), "right_finger_joint": (0.0, 0.05)}, 1.0)
    assert encounter(CollisionModel(robot), smooth_move({"a2": (0.0, 0.8)}, 1.0), fingers, others) is None


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner(PAIR)


def test_the_answer_names_what_touches(planner: Planner) -> None:
    answer = planner.answer(ConcurrencyQuestion(leaning("left", 0.0, -1.5), leaning("right", 0.0, 1.5), ZERO))
    assert isinstance(answer, RecheckAnswer)
    assert answer.contact is not None
    assert "left_" in answer.contact.message
    assert "right_" in answer.contact.message


def test_motions_of_one_joint_are_no_question(planner: Planner) -> None:
    answer = planner.answer(ConcurrencyQuestion(leaning("left", 0.0, 1.0), leaning("left", 0.0, 1.0), ZERO))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is MoveItErrorCode.INVALID_MOTION_PLAN
    assert "left_a1" in answer.message
