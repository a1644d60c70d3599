import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.cartesian.spline import SplinePath

coordinates = st.floats(-2.0, 2.0).map(lambda value: round(value, 3))
curves = st.lists(st.tuples(*[coordinates] * 3), min_size=2, max_size=12).map(np.array)
spacings = st.integers(1, 5)


def spline(points, spacing):
    """Knots now near each other, now further apart."""
    spans = 0.01 * (1.0 + np.arange(len(points) - 1) % spacing)
    return SplinePath(np.concatenate(([0.0], np.cumsum(spans))), points)


@given(curves, spacings)
def test_the_curve_goes_through_its_points(points, spacing):
    path = spline(points, spacing)
    np.testing.assert_allclose(path(path.knots), points, atol=1e-12)


@given(curves, spacings)
def test_slope_and_bend_are_the_derivatives_of_the_position(points, spacing):
    path = spline(points, spacing)
    middle = 0.5 * (path.knots[1:] + path.knots[:-1])
    step = 1e-6
    slope = (path(middle + step) - path(middle - step)) / (2 * step)
    bend = (path(middle + step, 1) - path(middle - step, 1)) / (2 * step)
    np.testing.assert_allclose(slope, path(middle, 1), atol=1e-5 * max(1.0, np.abs(slope).max()))
    np.testing.assert_allclose(bend, path(middle, 2), atol=1e-5 * max(1.0, np.abs(bend).max()))


@given(curves, spacings)
def test_slope_and_bend_do_not_jump_in_the_points(points, spacing):
    path = spline(points, spacing)
    before, after = np.nextafter(path.knots[1:-1], 0.0), np.nextafter(path.knots[1:-1], 9.0)
    for order in (1, 2):
        scale = max(1.0, np.abs(path(path.knots, order)).max())
        np.testing.assert_allclose(path(before, order), path(after, order), atol=1e-9 * scale)


@given(st.tuples(*[coordinates] * 3).map(np.array), spacings)
def test_points_on_a_line_make_a_line(direction, spacing):
    points = np.linspace(0.0, 1.0, 7)[:, np.newaxis] * direction
    path = SplinePath(np.linspace(0.0, 1.0, 7), points)
    at = np.linspace(0.0, 1.0, 50)
    np.testing.assert_allclose(path(at), at[:, np.newaxis] * direction, atol=1e-12)


@given(curves, spacings)
def test_the_grid_has_every_knot_and_rises(points, spacing):
    path = spline(points, spacing)
    assert np.all(np.diff(path.grid) > 0.0)
    assert np.abs(path.grid[:, np.newaxis] - path.knots).min(axis=0).max() < 1e-12


def test_points_that_are_not_finite_make_no_curve():
    with pytest.raises(ValueError, match="finite"):
        SplinePath(np.array([0.0, 1.0]), np.array([[0.0], [np.nan]]))
