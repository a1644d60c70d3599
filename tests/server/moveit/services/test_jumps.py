from __future__ import annotations

import math

import numpy as np
import pytest

from robot.forward import ForwardPlacements
from robot.trajectory import Trajectory
from server.moveit.services.cartesian_path import LEAST_JUMP_RAD, MAX_SAMPLES, Thresholds, first_jump
from tests.helpers.moveit_requests import HOME, ROBOT, TIP

FORWARD = ForwardPlacements(ROBOT)


def panned(*angles_rad: float, duration_s: float = 1.0) -> Trajectory:
    """The shoulder turns: the tip goes round on a circle of 0.35 m."""
    times = np.linspace(0.0, duration_s, len(angles_rad))
    positions = np.array(angles_rad)[:, np.newaxis]
    speeds = np.gradient(positions[:, 0], times)[:, np.newaxis] if len(times) > 1 else np.zeros((1, 1))
    return Trajectory(("shoulder_pan",), times, positions, speeds, np.zeros_like(positions))


def jump(motion, step_m=0.05, step_rad=0.0, factor=0.0):
    return first_jump(motion, (FORWARD, TIP), HOME, step_m, Thresholds(step_rad, factor))


EVEN = panned(*np.linspace(0.0, 1.0, 20))


def test_a_step_is_what_joints_do_while_the_tip_moves_by_a_length() -> None:
    radius_m = math.hypot(*FORWARD.transforms(HOME)[TIP][:2, 3] - FORWARD.transforms(HOME)["shoulder_link"][:2, 3])
    expected_rad = 0.05 / radius_m
    assert jump(EVEN, step_rad=1.02 * expected_rad) is None
    found = jump(EVEN, step_rad=0.98 * expected_rad)
    assert found is not None
    assert found.joint == "shoulder_pan"
    assert found.step_rad == pytest.approx(expected_rad, rel=0.01)


def test_an_even_motion_exceeds_no_factor() -> None:
    assert jump(EVEN, step_m=0.1, factor=1.2) is None


def test_the_mean_times_a_factor_is_the_limit_of_a_step() -> None:
    assert Thresholds(0.0, 2.0).limit_rad(np.array([0.5, 0.5, 2.0])) == pytest.approx(2.0)


def test_small_steps_exceed_no_factor() -> None:
    assert Thresholds(0.0, 2.0).limit_rad(np.array([0.01, 0.01])) == LEAST_JUMP_RAD


def test_of_two_thresholds_the_stricter_counts() -> None:
    assert Thresholds(0.3, 2.0).limit_rad(np.array([0.5, 0.5, 2.0])) == 0.3


def test_the_first_jump_is_told_with_the_length_before_it() -> None:
    assert jump(EVEN, step_rad=0.01).along_m == 0.0


def test_a_motion_that_stands_has_no_jump() -> None:
    assert jump(panned(0.3), step_rad=0.01, factor=1.0) is None


def test_without_thresholds_nothing_is_a_jump() -> None:
    assert not Thresholds(0.0, 0.0).any
    assert jump(EVEN) is None


def test_a_slow_path_is_looked_at_no_more_often_than_is_quick() -> None:
    placed = 0

    class Counting(ForwardPlacements):
        def transforms(self, positions_rad):
            nonlocal placed
            placed += 1
            return super().transforms(positions_rad)

    slow = panned(0.0, 1.0, duration_s=1000.0)
    assert first_jump(slow, (Counting(ROBOT), TIP), HOME, 0.05, Thresholds(9.0, 0.0)) is None
    assert placed <= MAX_SAMPLES
