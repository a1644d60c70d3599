from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.problem import Line
from planners.scene import Pose
from server.moveit.services.cartesian_path import cut_lines, length_m
from tests.helpers.examples import examples

HALF = math.sqrt(0.5)
START = Pose()
ALONG_X = Line(Pose((0.3, 0.0, 0.0)))
THEN_Y = Line(Pose((0.3, 0.4, 0.0), (0.0, 0.0, 1.0, 0.0)))


def test_the_length_of_a_path_is_that_of_its_lines() -> None:
    assert length_m(START, [ALONG_X, THEN_Y]) == pytest.approx(0.7)


@examples(50)
@given(st.floats(0.0, 0.7))
def test_what_is_left_has_the_length_that_is_wanted(along_m: float) -> None:
    assert length_m(START, cut_lines(START, [ALONG_X, THEN_Y], along_m)) == pytest.approx(along_m, abs=1e-12)


def test_lines_before_the_cut_stay_as_they_are() -> None:
    first, second = cut_lines(START, [ALONG_X, THEN_Y], 0.5)
    assert first is ALONG_X
    assert second.end.position_m == pytest.approx((0.3, 0.2, 0.0))


def test_an_orientation_is_cut_in_the_same_proportion() -> None:
    *_, last = cut_lines(START, [ALONG_X, THEN_Y], 0.5)
    assert last.end.orientation == pytest.approx((0.0, 0.0, HALF, HALF))


def test_orientations_turn_the_shorter_way() -> None:
    flipped = Line(Pose((1.0, 0.0, 0.0), (0.0, 0.0, -HALF, -HALF)))
    (half,) = cut_lines(START, [flipped], 0.5)
    assert abs(np.dot(half.end.orientation, (0.0, 0.0, math.sin(math.pi / 8), math.cos(math.pi / 8)))) > 1.0 - 1e-9


def test_a_cut_beyond_the_end_leaves_the_path_whole() -> None:
    assert cut_lines(START, [ALONG_X, THEN_Y], 9.0) == (ALONG_X, THEN_Y)


def test_a_path_that_only_turns_is_kept() -> None:
    turn = Line(Pose((0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)))
    assert cut_lines(START, [turn], 0.0) == (turn,)
