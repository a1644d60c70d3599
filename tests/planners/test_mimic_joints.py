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

PALLETIZER = model.parse(PALLETIZER_URDF, PALLETIZER_SRDF)
NAMES = ("turn", "boom", "grip")
FORWARD = ForwardKinematics(PALLETIZER, NAMES)
STATES = np.random.default_rng(1).uniform(-1.0, 1.0, (20, len(NAMES)))


@pytest.fixture
def collision():
    return CollisionModel(PALLETIZER)


@pytest.fixture(scope="module")
def planner():
    return Planner(PALLETIZER, time.process_time)


def place_m(q, link):
    FORWARD.place(q)
    return FORWARD.placement(link).translation.copy()


def test_both_kinematics_place_the_links_alike_and_the_jacobian_counts_what_follows():
    placements, step_rad = ForwardPlacements(PALLETIZER), 1e-6
    for q in STATES[:10]:
        FORWARD.place(q)
        transforms = placements.transforms(dict(zip(NAMES, q.tolist(), strict=True)))
        for link in PALLETIZER.links:
            np.testing.assert_allclose(FORWARD.placement(link).homogeneous, transforms[link], atol=1e-12)
    for q in STATES[:5]:
        for link in ("wrist", "right"):
            moved_m = [place_m(q + step, link) - place_m(q - step, link) for step in step_rad * np.eye(len(NAMES))]
            slopes = np.array(moved_m).T / (2.0 * step_rad)
            np.testing.assert_allclose(FORWARD.jacobian(q, link)[:3], slopes, atol=1e-8)


def test_no_point_travels_further_than_is_said(collision):
    step_rad = 1e-4
    for q in STATES:
        for column, step in enumerate(step_rad * np.eye(len(NAMES))):
            for link in ("wrist", "left", "right"):
                start_m, end_m = FORWARD.placements([q, q + step], link).positions_m
                most_m = collision.travel_m_per_rad[column] * step_rad * (1.0 + 1e-6)
                assert np.linalg.norm(end_m - start_m) <= most_m


def test_fingers_that_close_on_each_other_touch_and_are_said_to_come_nearer(collision):
    apart, way = np.zeros(3), 0.6 * (np.array(collision.joint_names) == "grip")
    assert frozenset(("left", "right")) in {pair.links for pair in collision.colliding_pairs(apart - way)}
    assert not collision.in_collision(apart)
    assert collision.near(apart, collision.approach_m_per_rad @ way)


@pytest.mark.parametrize("seed", range(4))
def test_position_goals_of_a_wrist_that_follows_are_reached(planner, seed):
    rng = np.random.default_rng(seed)
    wanted_m = place_m(np.array([rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 0.1), 0.0]), "wrist")
    goal = PositionGoal("wrist", tuple(wanted_m.tolist()), 0.001)
    plan = planner.plan(PlanningProblem("arm", dict.fromkeys(NAMES, 0.0), goal))
    assert isinstance(plan, Plan), plan
    ends = dict(zip(plan.trajectory.joint_names, plan.trajectory.positions_rad[-1].tolist(), strict=True))
    reached_m = place_m(np.array([ends.get(name, 0.0) for name in NAMES]), "wrist")
    assert np.linalg.norm(reached_m - wanted_m) <= 0.001


def test_a_finger_that_follows_touches_what_is_in_its_way(planner, put):
    grip = PlanningProblem("hand", dict.fromkeys(NAMES, 0.0), JointGoal({"grip": 1.0}))
    assert isinstance(planner.plan(grip), Plan)
    put(planner, thing(Box((0.02, 0.02, 0.2)), 0.47, -0.055, 0.12))
    answer = planner.plan(grip)
    assert not isinstance(answer, Plan)
    assert "right" in answer.message
