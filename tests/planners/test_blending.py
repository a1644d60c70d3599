from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.blending import BlendedPath

coordinates = st.floats(-2.0, 2.0, allow_nan=False).map(lambda value: round(value, 3))
polylines = (
    st.lists(st.tuples(*[coordinates] * 3), min_size=2, max_size=6)
    .map(np.array)
    .filter(lambda points: np.linalg.norm(np.diff(points, axis=0), axis=1).min() > 0.01)
)
blends = st.floats(0.0, 1.0, allow_nan=False).map(lambda value: round(value, 3))


def lengths(path, count=400):
    return np.linspace(*path.path_interval, count)


def distance_to_polyline(point, points):
    nearest = []
    for a, b in pairwise(points):
        share = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        nearest.append(np.linalg.norm(point - a - share * (b - a)))
    return min(nearest)


@given(polylines, blends)
def test_path_runs_from_the_first_point_to_the_last(points, blend_rad):
    path = BlendedPath(points, blend_rad)
    start, end = path.path_interval
    assert start == 0.0
    np.testing.assert_allclose(path(start), points[0], atol=1e-9)
    np.testing.assert_allclose(path(end), points[-1], atol=1e-7)


@given(polylines, blends)
def test_path_leaves_the_polyline_by_at_most_three_eighths_of_the_blend(points, blend_rad):
    path = BlendedPath(points, blend_rad)
    off = max(distance_to_polyline(point, points) for point in path(lengths(path)))
    assert off <= 0.375 * blend_rad + 1e-9


@given(polylines, st.floats(0.05, 1.0))
def test_tangent_and_curvature_are_the_derivatives_of_the_position(points, blend_rad):
    path = BlendedPath(points, blend_rad)
    s = lengths(path, 50)[1:-1]
    # A blend beside a short line is short itself, and differences see its curvature change.
    step = 1e-3 * min(np.diff(path.knots).min(), 0.1)
    np.testing.assert_allclose((path(s + step) - path(s - step)) / (2 * step), path(s, 1), atol=1e-2)
    scale = max(1.0, float(np.abs(path(s, 2)).max()))
    np.testing.assert_allclose((path(s + step, 1) - path(s - step, 1)) / (2 * step), path(s, 2), atol=2e-2 * scale)


@given(polylines, st.floats(0.05, 1.0))
def test_tangent_and_curvature_do_not_jump_between_lines_and_blends(points, blend_rad):
    path = BlendedPath(points, blend_rad)
    for knot in path.knots[1:-1]:
        before, after = np.nextafter(knot, 0.0), np.nextafter(knot, 100.0)
        if all(path.in_blend):
            continue
        np.testing.assert_allclose(path(before, 1), path(after, 1), atol=1e-6)
        assert np.abs(path(before, 2) - path(after, 2)).max() < 1e-3


def test_without_blends_the_path_is_the_polyline():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    path = BlendedPath(points, 0.0)
    np.testing.assert_allclose(path(np.array([0.5, 1.0, 2.0])), [[0.5, 0.0], [1.0, 0.0], [1.0, 1.0]])


def test_a_number_gives_one_point_and_an_array_gives_many():
    path = BlendedPath(np.array([[0.0, 0.0], [1.0, 0.0]]), 0.1)
    assert path.dof == 2
    assert path(0.5).shape == (2,)
    assert path(np.array([0.5])).shape == (1, 2)


@pytest.mark.parametrize("blend_rad", [0.1, 5.0])
def test_a_blend_takes_at_most_half_of_a_line(blend_rad):
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.4], [0.0, 0.4]])
    path = BlendedPath(points, blend_rad)
    middle = 0.5 * (points[1] + points[2])
    assert min(np.linalg.norm(path(lengths(path, 4000)) - middle, axis=1)) < 1e-3
