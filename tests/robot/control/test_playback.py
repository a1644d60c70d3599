from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot.control.playback import BRAKING_SHARE, Playback
from tests.helpers.trajectories import smooth_move

PERIOD_S = 0.01
MAX_ACCELERATION = np.array([6.0, 5.0])
MOVES = {"shoulder_pan": (0.0, 1.2), "elbow_flex": (0.5, -0.4)}


def play(stop_after_s: float, duration_s: float = 2.0) -> tuple[Playback, np.ndarray]:
    """Play until nothing moves; the goals of all ticks."""
    playback = Playback(smooth_move(MOVES, duration_s), MAX_ACCELERATION)
    goals = [playback.advance(0.0)]
    for tick in itertools.count(1):
        if tick * PERIOD_S >= stop_after_s:
            playback.stop()
        goals.append(playback.advance(PERIOD_S))
        if playback.finished:
            return playback, np.array(goals)
        assert tick < 1000
    raise AssertionError


def distance_from_line(goals: np.ndarray) -> np.ndarray:
    start, end = np.array([0.0, 0.5]), np.array([1.2, -0.4])
    direction = (end - start) / np.linalg.norm(end - start)
    offset = goals - start
    return np.linalg.norm(offset - np.outer(offset @ direction, direction), axis=1)


def test_played_to_the_end_it_arrives_at_the_end() -> None:
    playback, goals = play(stop_after_s=99.0)
    assert playback.completed
    assert playback.fraction == 1.0
    assert goals[-1] == pytest.approx([1.2, -0.4])


@settings(max_examples=50)
@given(st.floats(min_value=0.0, max_value=1.95), st.floats(min_value=1.3, max_value=4.0))
def test_a_stop_stays_on_the_path_and_within_the_acceleration_limits(stop_after_s: float, duration_s: float) -> None:
    playback, goals = play(stop_after_s, duration_s)
    assert distance_from_line(goals) == pytest.approx(np.zeros(len(goals)), abs=1e-9)
    accelerations = np.abs(np.diff(goals, n=2, axis=0)) / PERIOD_S**2
    # The path's own share and the braking share together, and one tick of discretisation.
    assert (accelerations <= MAX_ACCELERATION * (1.0 + BRAKING_SHARE) + 0.5).all()
    assert playback.remaining_s >= 0.0


def test_a_stop_comes_to_rest_before_the_end_of_the_motion() -> None:
    playback, goals = play(stop_after_s=0.5)
    assert not playback.completed
    assert 0.0 < playback.fraction < 0.7
    assert np.abs(goals[-1] - goals[-2]).max() < 0.002


def test_the_first_tick_after_a_stop_is_slower_than_the_last_one_before() -> None:
    playback = Playback(smooth_move(MOVES, 2.0), MAX_ACCELERATION)
    goals = [playback.advance(PERIOD_S) for _ in range(100)]
    playback.stop()
    goals += [playback.advance(PERIOD_S)]
    before, after = np.abs(goals[-2] - goals[-3]), np.abs(goals[-1] - goals[-2])
    assert (after < before).all()


def test_time_that_does_not_pass_changes_nothing() -> None:
    playback = Playback(smooth_move(MOVES, 2.0), MAX_ACCELERATION)
    playback.stop()
    assert playback.advance(0.0) == pytest.approx([0.0, 0.5])
