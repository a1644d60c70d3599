import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.moveit.scene.shapes import prism

SQUARE = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]
HOOK = [(0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (2.0, 3.0), (2.0, 1.0), (0.0, 1.0)]


def volume_m3(mesh):
    """By the divergence theorem, above 0 when every triangle is seen counter-clockwise from outside."""
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


@pytest.mark.parametrize(("polygon", "area_m2"), [(SQUARE, 4.0), (HOOK, 5.0), (HOOK[::-1], 5.0)])
def test_the_surface_encloses_the_polygon_times_the_height(polygon, area_m2):
    assert volume_m3(prism(polygon, 0.5)) == pytest.approx(0.5 * area_m2)


def test_the_middle_is_at_half_the_height():
    heights_m = prism(SQUARE, 0.5).vertices_m[:, 2]
    assert (heights_m.min(), heights_m.max()) == (-0.25, 0.25)


@given(st.lists(st.floats(0.5, 2.0), min_size=3, max_size=12), st.booleans())
def test_a_star_of_any_radii_is_closed_and_keeps_its_area(radii_m, clockwise):
    angles = np.linspace(0.0, 2.0 * math.pi, len(radii_m), endpoint=False)
    polygon = [(r * math.cos(a), r * math.sin(a)) for r, a in zip(radii_m, angles, strict=True)]
    following = [*polygon[1:], polygon[0]]
    area_m2 = 0.5 * sum(x * v - u * y for (x, y), (u, v) in zip(polygon, following, strict=True))
    surface = prism(polygon[::-1] if clockwise else polygon, 1.0)
    assert volume_m3(surface) == pytest.approx(area_m2)
    edges = [tuple(t[[i, (i + 1) % 3]]) for t in surface.triangles for i in range(3)]
    assert len(set(edges)) == len(edges)
    assert all((b, a) in edges for a, b in edges)


@pytest.mark.parametrize(
    "polygon", [[(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)], [(0.0, 0.0), (2.0, 2.0), (2.0, 0.0), (0.0, 2.0)]]
)
def test_a_polygon_without_area_or_that_crosses_itself_has_no_surface(polygon):
    assert prism(polygon, 1.0) is None
