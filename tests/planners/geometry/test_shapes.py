from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import robot.description
from planners.errors import ShapeError
from planners.geometry.collision import CollisionModel
from planners.geometry.hulls import convex
from planners.geometry.shapes import link_name, outline, robot_shapes, scaled, urdf_shapes
from planners.geometry.skeleton import kinematic_urdf
from robot.description import model
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF, stl


def shapes_of(arm):
    pin_model = pin.buildModelFromXML(kinematic_urdf(arm))
    return pin_model, robot_shapes(arm, pin_model)


def test_without_hulls_the_shapes_of_the_urdf_are_used():
    pin_model, shapes = shapes_of(model.parse(CRANE_URDF, CRANE_SRDF))
    kinds = {link_name(pin_model, shape): type(shape.geometry) for shape in shapes}
    assert kinds == {"foot": coal.Box, "mast": coal.Cylinder, "boom": coal.Box, "rod": coal.Sphere}


def test_outline_of_a_shape_encloses_it_in_the_frame_of_its_joint():
    _, shapes = shapes_of(model.parse(CRANE_URDF, CRANE_SRDF))
    boom = next(shape for shape in shapes if shape.name.startswith("boom"))
    points = outline(boom)
    np.testing.assert_allclose(points.min(axis=0), (0.0, -0.01, -0.01), atol=1e-9)
    np.testing.assert_allclose(points.max(axis=0), (0.3, 0.01, 0.01), atol=1e-9)


def test_robot_without_any_shape_is_refused():
    bare = model.parse(CRANE_URDF, CRANE_SRDF)
    bare = model.parse(kinematic_urdf(bare), CRANE_SRDF)
    with pytest.raises(ShapeError, match="no link has a collision shape"):
        shapes_of(bare)


def test_missing_mesh_is_refused_by_name(tmp_path):
    urdf = CRANE_URDF.replace('<box size="0.3 0.02 0.02"/>', '<mesh filename="gone.stl"/>')
    with pytest.raises(ShapeError, match=r"gone\.stl"):
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


def test_shapes_of_the_urdf_keep_all_triangles_where_they_are_asked_for(tmp_path):
    (tmp_path / "boom.stl").write_text(_tetrahedron_stl())
    urdf = CRANE_URDF.replace('<box size="0.3 0.02 0.02"/>', '<mesh filename="boom.stl"/>')
    arm = model.parse(urdf, CRANE_SRDF, mesh_directory=tmp_path)
    kinds = {shape.name: type(shape.geometry) for shape in urdf_shapes(arm, shapes_of(arm)[0])}
    assert kinds["boom_0"] == coal.BVHModelOBBRSS


@pytest.mark.parametrize("shape", [coal.Box(0.1, 0.2, 0.3), convex(np.random.default_rng(1).normal(size=(20, 3)))])
def test_a_scaled_shape_grows_about_its_middle(shape):
    shape.computeLocalAABB()
    larger = scaled(shape, 1.5)
    larger.computeLocalAABB()
    middle = 0.5 * (shape.aabb_local.min_ + shape.aabb_local.max_)
    np.testing.assert_allclose(larger.aabb_local.min_ - middle, 1.5 * (shape.aabb_local.min_ - middle), atol=1e-9)
    np.testing.assert_allclose(larger.aabb_local.max_ - middle, 1.5 * (shape.aabb_local.max_ - middle), atol=1e-9)


def test_official_description_collides_only_where_the_hulls_do(shared_data, collision):
    srdf = Path(robot.description.__file__).with_name("so101.srdf")
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
