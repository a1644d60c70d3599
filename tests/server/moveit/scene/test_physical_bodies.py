"""Shapes of collision objects as bodies of the physics."""

from typing import Any

import numpy as np
import pytest

from robot.physics.bodies import MAX_HULL_CORNERS, BodyShape
from server.moveit.scene.physical_bodies import body_of
from tests.helpers.moveit import collision_object, pose, scene_state


def shape_of(**fields: Any) -> BodyShape:
    contents = scene_state(collision_object(id="it", **fields)).contents
    (shape,) = body_of(contents.objects["it"]).shapes
    return shape


@pytest.mark.parametrize(
    ("kind", "expected"), [(2, ("sphere", (0.06,))), (3, ("cylinder", (0.02, 0.03))), (4, ("hull", ()))]
)
def test_round_shapes(kind: int, expected: tuple[str, tuple[float, ...]]) -> None:
    shape = shape_of(primitives=[{"type": kind, "dimensions": [0.06, 0.02]}], primitive_poses=[pose()])
    assert (shape.kind, shape.size_m) == expected
    if kind == 4:
        assert np.ptp(np.array(shape.vertices_m), axis=0) == pytest.approx([0.04, 0.04, 0.06])


@pytest.mark.parametrize(
    ("normal", "place"), [((0.0, 0.0, 1.0), (0.0, 0.0, -0.05)), ((0.0, 0.0, -1.0), (0.0, 0.0, 0.05))]
)
def test_a_plane_has_its_normal_along_z(normal: tuple[float, ...], place: tuple[float, ...]) -> None:
    shape = shape_of(planes=[{"coef": [*normal, 0.05]}], plane_poses=[pose()])
    assert shape.position_m == pytest.approx(place)
    x, y, _, _ = shape.orientation
    assert 1.0 - 2.0 * (x * x + y * y) == pytest.approx(normal[2])


def test_a_mesh_of_many_corners_has_its_outermost_ones() -> None:
    vertices = np.random.default_rng(3).normal(size=(3000, 3))
    vertices *= 0.05 / np.linalg.norm(vertices, axis=1)[:, np.newaxis]
    mesh = {
        "vertices": [dict(zip("xyz", each, strict=True)) for each in vertices.tolist()],
        "triangles": [{"vertex_indices": [at, at + 1, at + 2]} for at in range(0, 2998, 3)],
    }
    corners = np.array(shape_of(meshes=[mesh], mesh_poses=[pose()]).vertices_m)
    assert 100 < len(corners) <= MAX_HULL_CORNERS
    assert np.ptp(corners, axis=0) == pytest.approx([0.1] * 3, rel=0.02)
