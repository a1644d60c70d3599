import coal
import numpy as np
import pytest

from planners.geometry.world import placement, solid
from planners.scene import Box, Cone, Cylinder, Mesh, Plane, Pose, Sphere

CORNERS = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
FACES = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], dtype=np.int32)

SHAPES = [
    Box((0.1, 0.1, 0.1)),
    Sphere(0.1),
    Cylinder(0.1, 0.2),
    Cone(0.1, 0.2),
    Plane((0.0, 0.0, 1.0), 0.0),
    Mesh(CORNERS, FACES),
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_every_shape_becomes_one_of_coal(shape):
    geometry, _ = solid(shape, 1.0)
    assert isinstance(geometry, coal.CollisionGeometry)


def test_quaternions_are_brought_to_length_one():
    turned = placement(Pose((1.0, 2.0, 3.0), (0.0, 0.0, 2.0, 2.0)))
    np.testing.assert_allclose(turned.rotation @ (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(turned.translation, (1.0, 2.0, 3.0))


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 2.0, -2.0)])
def test_a_plane_is_solid_below_and_ends_at_its_surface(normal):
    box, place = solid(Plane(normal, 0.3), 1.0)
    up = np.array(normal) / np.linalg.norm(normal)
    for height_m, inside in ((0.299, True), (0.301, False), (-1.0, True)):
        for beside_m in np.random.default_rng(1).uniform(-1.0, 1.0, (10, 3)):
            point = height_m * up + beside_m - up * (beside_m @ up)
            assert np.all(np.abs(place.actInv(point)) <= 0.5 * np.array(2.0 * box.halfSide)) == inside
