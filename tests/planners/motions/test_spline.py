from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from planners.motions.spline import NaturalSpline


@pytest.mark.parametrize("count", [2, 3, 4, 5, 8, 37, 400])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_the_curve_is_the_natural_cubic_spline(count, order):
    rng = np.random.default_rng(count)
    knots = np.cumsum(rng.uniform(0.01, 1.0, count))
    points = rng.normal(size=(count, 6))
    at = np.concatenate((knots, rng.uniform(knots[0] - 0.1, knots[-1] + 0.1, 200)))
    expected = CubicSpline(knots, points, bc_type="natural")(at, order)
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(NaturalSpline(knots, points)(at, order), expected, atol=1e-9 * scale)
