import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.errors import ShapeError
from planners.geometry.collision import CollisionModel
from planners.geometry.shapes import (
    MAX_CORNERS,
    PLATE_M,
    convex,
    enclosing,
    kinematic_urdf,
    outline,
    robot_shapes,
    scaled,
    solid,
)
from planners.scene import Plane
from robot.description import model
from tests.helpers import robots
from tests.helpers.resources import examples
from tests.planners.scenes import outside_m
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF, stl

CUBE = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])


@examples(20)
@given(st.integers(0, 1000), st.tuples(*[st.floats(0.01, 1.0)] * 3))
def test_many_points_are_enclosed_by_few_corners(seed, size_m):
    points = np.random.default_rng(seed).normal(size=(2000, 3))
    points = 0.3 + np.array(size_m) * points / np.linalg.norm(points, axis=1)[:, None]
    hull = enclosing(points)
    assert len(hull.points()) <= MAX_CORNERS
    assert outside_m(hull, points).max() < 1e-9
    assert hull.computeVolume() < 1.2 * convex(points).computeVolume()


@pytest.mark.parametrize("flat", [(1.0, 1.0, 0.0), (1.0, 1.0, 1e-9), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_flat_points_get_a_thin_plate(flat):
    points = CUBE * flat
    hull = convex(points)
    assert outside_m(hull, points).max() < 0.0
    assert np.max(np.ptp(hull.points(), axis=0) - np.ptp(points, axis=0)) <= 2.0 * PLATE_M + 1e-12


def test_a_corner_with_hundreds_of_neighbours_is_enclosed():
    angles = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
    cone = np.vstack((np.stack((np.cos(angles), np.sin(angles), 0.0 * angles), axis=1), [(0.0, 0.0, 1.0)]))
    with pytest.raises(RuntimeError, match="Too many neighbors"):
        convex(cone)
    assert outside_m(enclosing(cone), cone).max() < 1e-9


def shapes_of(arm):
    pin_model = pin.buildModelFromXML(kinematic_urdf(arm))
    return pin_model, robot_shapes(arm, pin_model)


def test_robot_without_any_shape_is_refused():
    bare = model.parse(CRANE_URDF, CRANE_SRDF)
    bare = model.parse(kinematic_urdf(bare), CRANE_SRDF)
    with pytest.raises(ShapeError, match="no link has a collision shape"):
        shapes_of(bare)


def test_a_mesh_that_goes_after_the_description_was_read_is_refused_by_name(tmp_path):
    (tmp_path / "boom.stl").write_text(_tetrahedron_stl())
    urdf = CRANE_URDF.replace('<box size="0.3 0.02 0.02"/>', '<mesh filename="boom.stl"/>')
    robot = model.parse(urdf, CRANE_SRDF, mesh_directory=tmp_path)
    (tmp_path / "boom.stl").unlink()
    with pytest.raises(ShapeError, match=r"boom\.stl"):
        shapes_of(robot)


def test_a_mesh_that_cannot_be_read_is_refused_in_one_line_that_says_why(tmp_path):
    (tmp_path / "boom.stl").write_bytes(bytes(200))
    urdf = CRANE_URDF.replace('<box size="0.3 0.02 0.02"/>', '<mesh filename="boom.stl"/>')
    with pytest.raises(ShapeError, match=r": cannot be loaded: Could not load resource \S+/boom\.stl [^\n]+$"):
        shapes_of(model.parse(urdf, CRANE_SRDF, mesh_directory=tmp_path))


@pytest.mark.parametrize("prefix", ["", "package://{folder}/"])
def test_meshes_are_found_beside_the_urdf_and_replaced_by_hulls(tmp_path, prefix):
    (tmp_path / "boom.stl").write_text(_tetrahedron_stl())
    name = prefix.format(folder=tmp_path.name) + "boom.stl"
    urdf = CRANE_URDF.replace('<box size="0.3 0.02 0.02"/>', f'<mesh filename="{name}"/>')
    _, shapes = shapes_of(model.parse(urdf, CRANE_SRDF, mesh_directory=tmp_path))
    boom = next(shape for shape in shapes if shape.name.startswith("boom"))
    assert isinstance(boom.geometry, coal.Convex)
    assert len(outline(boom)) == 4


@pytest.mark.parametrize("shape", [coal.Box(0.1, 0.2, 0.3), convex(np.random.default_rng(1).normal(size=(20, 3)))])
def test_a_scaled_shape_grows_about_its_middle(shape):
    shape.computeLocalAABB()
    larger = scaled(shape, 1.5)
    larger.computeLocalAABB()
    middle = 0.5 * (shape.aabb_local.min_ + shape.aabb_local.max_)
    np.testing.assert_allclose(larger.aabb_local.min_ - middle, 1.5 * (shape.aabb_local.min_ - middle), atol=1e-9)
    np.testing.assert_allclose(larger.aabb_local.max_ - middle, 1.5 * (shape.aabb_local.max_ - middle), atol=1e-9)


def test_official_description_collides_only_where_the_hulls_do(shared_data, collision):
    srdf = robots.SO101.folder / "so101.srdf"
    official = CollisionModel(model.load(shared_data / "so101" / "so101_new_calib.urdf", srdf))
    assert official.joint_names == collision.joint_names
    rng = np.random.default_rng(1)
    states = rng.uniform(collision.lower_rad, collision.upper_rad, (500, 6))
    touching = [q for q in states if official.in_collision(q)]
    assert touching
    assert all(collision.in_collision(q) for q in touching)


def _tetrahedron_stl():
    corners = [(0, 0, 0), (0.3, 0, 0), (0, 0.02, 0), (0, 0, 0.02)]
    return stl([[corners[i] for i in face] for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))])


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 2.0, -2.0)])
def test_a_plane_is_solid_below_and_ends_at_its_surface(normal):
    box, place = solid(Plane(normal, 0.3), 1.0)
    up = np.array(normal) / np.linalg.norm(normal)
    for height_m, inside in ((0.299, True), (0.301, False), (-1.0, True)):
        for beside_m in np.random.default_rng(1).uniform(-1.0, 1.0, (10, 3)):
            point = height_m * up + beside_m - up * (beside_m @ up)
            assert np.all(np.abs(place.actInv(point)) <= 0.5 * np.array(2.0 * box.halfSide)) == inside
