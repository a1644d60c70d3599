"""Sticks moved at random above a table, whose distance is kept whatever the other joints do."""

from __future__ import annotations

import numpy as np
import pytest

from planners.geometry.collision import CollisionModel
from planners.pipeline import Planner
from planners.scene import Box
from planners.servo.question import ServoLimits, TipTwist
from tests.helpers.resources import in_proportion
from tests.planners.scenes import thing
from tests.planners.servo.steering import SteeredArm, least_distance_m

LIMITS = ServoLimits()
HOLD_S, TRIAL_S = 0.4, 3.2


@pytest.fixture
def table(planner: Planner, robot, put) -> CollisionModel:
    collision = CollisionModel(robot)
    for model in (planner, collision):
        put(model, thing(Box((1.0, 1.0, 0.04)), 0.3, 0.0, -0.03))
    return collision


def stick(turns: list[tuple[float, float, float]], downwards: list[tuple[float, float, float]]):
    """A stick that is held for a while, then moved to another place."""

    def command(at_s: float) -> TipTwist:
        number = round(at_s / HOLD_S - 0.5) % len(turns)
        linear = np.array(downwards[number]) * LIMITS.linear_m_s
        angular = np.array(turns[number]) * LIMITS.angular_rad_s
        return TipTwist((linear[0], linear[1], linear[2]), (angular[0], angular[1], angular[2]))

    return command


def test_a_turn_that_is_reversed_on_the_way_down_keeps_the_distance(planner, robot, table) -> None:
    arm = SteeredArm(planner, robot)
    arm.steer(stick([(0.0, 1.0, 0.0), (0.0, -1.0, 0.0)], [(0.0, 0.0, -1.0)] * 2), TRIAL_S)
    assert least_distance_m(arm, table) > LIMITS.scene_distance_m


@pytest.mark.parametrize("seed", range(in_proportion(4)))
def test_random_sticks_keep_the_distance(planner, robot, table, seed: int) -> None:
    random = np.random.default_rng(seed)
    count = round(TRIAL_S / HOLD_S)
    drawn = random.normal(size=(2, count, 3))
    drawn /= np.linalg.norm(drawn, axis=2, keepdims=True)
    drawn[1, :, 2] = -np.abs(drawn[1, :, 2])
    arm = SteeredArm(planner, robot)
    arm.steer(stick([tuple(turn) for turn in drawn[0]], [tuple(way) for way in drawn[1]]), TRIAL_S)
    assert least_distance_m(arm, table) > LIMITS.scene_distance_m
