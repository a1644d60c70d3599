"""Joints that follow others, at the wrist and at the fingers of an arm."""

import time

import numpy as np
import pytest

from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics
from planners.goals import JointGoal, PositionGoal
from planners.pipeline import Planner
from planners.problem import Plan, PlanningProblem
from planners.scene import Box
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from tests.planners.scenes import thing
from tests.planners.small_arms import PALLETIZER_SRDF, PALLETIZER_URDF

NAMES = ("turn", "boom", "grip")


@pytest.fixture(scope="module")
def palletizer():
    return model.parse(PALLETIZER_URDF, PALLETIZER_SRDF)


@pytest.fixture
def collision(palletizer):
    return CollisionModel(palletizer)


@pytest.fixture(scope="module")
def planner(palletizer):
    return Planner(palletizer, time.process_time)


def states(count):
    return np.random.default_rng(1).uniform(-1.0, 1.0, (count, len(NAMES)))


def test_both_kinematics_place_the_links_alike(palletizer):
    forward, placements = ForwardKinematics(palletizer, NAMES), ForwardPlacements(palletizer)
    for q in states(10):
        forward.place(q)
        transforms = placements.transforms(dict(zip(NAMES, q.tolist(), strict=True)))
        for link in palletizer.links:
            np.testing.assert_allclose(forward.placement(link).homogeneous, transforms[link], atol=1e-12)


def test_the_jacobian_counts_what_follows(palletizer):
    forward, step_rad = ForwardKinematics(palletizer, NAMES), 1e-6
    for q in states(5):
        for link in ("wrist", "right"):
            jacobian = forward.jacobian(q, link)
            for column in range(len(NAMES)):
                ends = []
                for sign in (-1.0, 1.0):
                    forward.place(q + sign * step_rad * np.eye(len(NAMES))[column])
                    ends.append(forward.placement(link).translation.copy())
                np.testing.assert_allclose(jacobian[:3, column], (ends[1] - ends[0]) / (2.0 * step_rad), atol=1e-8)


def test_no_point_travels_further_than_is_said(collision):
    step_rad = 1e-4
    for q in states(20):
        for column in range(len(NAMES)):
            moved = q + step_rad * np.eye(len(NAMES))[column]
            for link in ("wrist", "left", "right"):
                ends = collision.tip_positions([q, moved], link)
                travel_m = float(np.linalg.norm(ends[1] - ends[0]))
                assert travel_m <= collision.travel_m_per_rad[column] * step_rad * (1.0 + 1e-6)


def test_fingers_that_close_on_each_other_touch_and_are_said_to_come_nearer(collision):
    apart, closed = np.zeros(3), np.zeros(3)
    column = collision.joint_names.index("grip")
    closed[column] = -0.6
    assert frozenset(("left", "right")) in {pair.links for pair in collision.colliding_pairs(closed)}
    assert not collision.in_collision(apart)
    travel = np.zeros((1, 3))
    travel[0, column] = 0.6
    assert collision.candidate_pairs(apart, collision.margins_m(travel)[0])


@pytest.mark.parametrize("seed", range(4))
def test_position_goals_of_a_wrist_that_follows_are_reached(planner, palletizer, seed):
    forward = ForwardKinematics(palletizer, NAMES)
    rng = np.random.default_rng(seed)
    q = np.array([rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 0.1), 0.0])
    forward.place(q)
    goal = PositionGoal("wrist", tuple(forward.placement("wrist").translation.tolist()), 0.001)
    plan = planner.plan(PlanningProblem("arm", dict.fromkeys(NAMES, 0.0), goal))
    assert isinstance(plan, Plan), plan
    reached = dict.fromkeys(NAMES, 0.0) | dict(
        zip(plan.trajectory.joint_names, plan.trajectory.positions_rad[-1].tolist(), strict=True)
    )
    forward.place(np.array([reached[name] for name in NAMES]))
    assert np.linalg.norm(forward.placement("wrist").translation - goal.position_m) <= 0.001


def test_a_finger_that_follows_touches_what_is_in_its_way(planner, put):
    grip = PlanningProblem("hand", dict.fromkeys(NAMES, 0.0), JointGoal({"grip": 1.0}))
    assert isinstance(planner.plan(grip), Plan)
    put(planner, thing(Box((0.02, 0.02, 0.2)), 0.47, -0.055, 0.12))
    answer = planner.plan(grip)
    assert not isinstance(answer, Plan)
    assert "right" in answer.message
