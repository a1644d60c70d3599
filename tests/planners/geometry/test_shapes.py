import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.errors import ShapeError
from planners.geometry import shapes
from planners.geometry.shapes import convex, enclosing, kinematic_urdf
from planners.scene import Plane
from robot.description import model
from tests.helpers.resources import examples
from tests.planners.scenes import FACES, outside_m
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF, stl

CUBE = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])


@examples(20)
@given(st.integers(0, 1000), st.tuples(*[st.floats(0.01, 1.0)] * 3), st.sampled_from([2000, shapes.MANY_POINTS]))
def test_many_points_are_enclosed_by_few_corners(seed, size_m, count):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    points = 0.3 + np.array(size_m) * points / np.linalg.norm(points, axis=1)[:, None]
    hull = enclosing(points)
    assert len(hull.points()) <= shapes.MAX_CORNERS
    assert outside_m(hull, points).max() < 1e-9
    assert hull.computeVolume() < 1.2 * convex(points).computeVolume()


def test_flat_points_get_a_thin_plate():
    for flat in ((1.0, 1.0, 0.0), (1.0, 1.0, 1e-9), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)):
        points = CUBE * flat
        hull = convex(points)
        assert outside_m(hull, points).max() < 0.0, flat
        assert np.max(np.ptp(hull.points(), axis=0) - np.ptp(points, axis=0)) <= 2.0 * shapes.PLATE_M + 1e-12, flat


def test_a_corner_with_hundreds_of_neighbours_is_enclosed():
    angles = np.linspace(0.0, 2.0 * np.pi, 500, endpoint=False)
    cone = np.vstack((np.stack((np.cos(angles), np.sin(angles), 0.0 * angles), axis=1), [(0.0, 0.0, 1.0)]))
    with pytest.raises(RuntimeError, match="Too many neighbors"):
        convex(cone)
    assert outside_m(enclosing(cone), cone).max() < 1e-9


def shapes_of(arm):
    return shapes.robot_shapes(arm, pin.buildModelFromXML(kinematic_urdf(arm)))


def crane(folder, content, name="boom.stl"):
    """A crane whose boom is the mesh in a file."""
    (folder / "boom.stl").write_bytes(content)
    urdf = CRANE_URDF.replace('<box size="0.3 0.02 0.02"/>', f'<mesh filename="{name}"/>')
    return model.parse(urdf, CRANE_SRDF, mesh_directory=folder)


CORNERS_M = np.array([(0, 0, 0), (0.3, 0, 0), (0, 0.02, 0), (0, 0, 0.02)])
TETRAHEDRON = stl(CORNERS_M[FACES]).encode()


def test_a_robot_without_any_shape_or_with_a_mesh_that_is_gone_or_cannot_be_read_is_refused_in_one_line(tmp_path):
    bare = model.parse(kinematic_urdf(model.parse(CRANE_URDF, CRANE_SRDF)), CRANE_SRDF)
    with pytest.raises(ShapeError, match="no link has a collision shape"):
        shapes_of(bare)
    robot = crane(tmp_path, TETRAHEDRON)
    (tmp_path / "boom.stl").unlink()
    with pytest.raises(ShapeError, match=r"boom\.stl"):
        shapes_of(robot)
    with pytest.raises(ShapeError, match=r": cannot be loaded: Could not load resource \S+/boom\.stl [^\n]+$"):
        shapes_of(crane(tmp_path, bytes(200)))


def test_meshes_are_found_beside_the_urdf_and_replaced_by_hulls(tmp_path):
    for name in ("boom.stl", f"package://{tmp_path.name}/boom.stl"):
        found = shapes_of(crane(tmp_path, TETRAHEDRON, name))
        boom = next(shape for shape in found if shape.name.startswith("boom"))
        assert isinstance(boom.geometry, coal.Convex)
        assert len(shapes.outline(boom)) == 4


def test_a_scaled_shape_grows_about_its_middle():
    for shape in (coal.Box(0.1, 0.2, 0.3), convex(np.random.default_rng(1).normal(size=(20, 3)))):
        larger = shapes.scaled(shape, 1.5)
        for each in (shape, larger):
            each.computeLocalAABB()
        middle = 0.5 * (shape.aabb_local.min_ + shape.aabb_local.max_)
        np.testing.assert_allclose(larger.aabb_local.min_ - middle, 1.5 * (shape.aabb_local.min_ - middle), atol=1e-9)
        np.testing.assert_allclose(larger.aabb_local.max_ - middle, 1.5 * (shape.aabb_local.max_ - middle), atol=1e-9)


def test_a_plane_is_solid_below_and_ends_at_its_surface():
    for normal in ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 2.0, -2.0)):
        box, place = shapes.solid(Plane(normal, 0.3), 1.0)
        up = np.array(normal) / np.linalg.norm(normal)
        for height_m, inside in ((0.299, True), (0.301, False), (-1.0, True)):
            for beside_m in np.random.default_rng(1).uniform(-1.0, 1.0, (10, 3)):
                point = height_m * up + beside_m - up * (beside_m @ up)
                assert np.all(np.abs(place.actInv(point)) <= 0.5 * np.array(2.0 * box.halfSide)) == inside
