import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.geometry.hulls import MAX_CORNERS, PLATE_M, convex, enclosing
from tests.helpers.examples import examples

CUBE = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])


def outside_m(hull, points):
    """How far the farthest of the points is outside of a hull."""
    corners = np.asarray(hull.points())
    triangles = [hull.polygons(i) for i in range(hull.num_polygons)]
    a, b, c = (corners[[triangle[k] for triangle in triangles]] for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals, a = normals[lengths > 1e-12] / lengths[lengths > 1e-12, None], a[lengths > 1e-12]
    heights = (normals * a).sum(axis=1)
    inwards = np.sign(heights - normals @ corners.mean(axis=0))
    return np.max((points @ normals.T - heights) * inwards)


def test_few_corners_stay_as_they_are():
    hull = enclosing(np.vstack((CUBE, 0.5 * CUBE + 0.2)))
    assert {tuple(corner) for corner in hull.points()} == {tuple(corner) for corner in CUBE}


@examples(20)
@given(st.integers(0, 1000), st.tuples(*[st.floats(0.01, 1.0)] * 3))
def test_many_points_are_enclosed_by_few_corners(seed, size_m):
    points = np.random.default_rng(seed).normal(size=(2000, 3))
    points = 0.3 + np.array(size_m) * points / np.linalg.norm(points, axis=1)[:, None]
    hull = enclosing(points)
    assert len(hull.points()) <= MAX_CORNERS
    assert outside_m(hull, points) < 1e-9
    assert hull.computeVolume() < 1.2 * convex(points).computeVolume()


@pytest.mark.parametrize("flat", [(1.0, 1.0, 0.0), (1.0, 1.0, 1e-9), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_flat_points_get_a_thin_plate(flat):
    points = CUBE * flat
    hull = convex(points)
    assert outside_m(hull, points) < 0.0
    assert np.max(np.ptp(hull.points(), axis=0) - np.ptp(points, axis=0)) <= 2.0 * PLATE_M + 1e-12


def test_a_corner_with_hundreds_of_neighbours_is_enclosed():
    angles = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
    cone = np.vstack((np.stack((np.cos(angles), np.sin(angles), 0.0 * angles), axis=1), [(0.0, 0.0, 1.0)]))
    with pytest.raises(RuntimeError, match="Too many neighbors"):
        convex(cone)
    assert outside_m(enclosing(cone), cone) < 1e-9
