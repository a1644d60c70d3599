"""Bodies smaller than a link is thick, inside its material and just outside of it."""

import io
import zipfile

import numpy as np
import pinocchio as pin
import pytest

from harness.meshes import ball
from planners.errors import ShapeError
from planners.geometry import surfaces
from planners.geometry.certificate import certify, line_free
from planners.geometry.joint_space import JointSpace
from planners.geometry.shapes import kinematic_urdf
from planners.scene import AttachedObject, Cylinder, Mesh, Sphere
from robot.description.meshes import MAX_SURFACES_BYTES
from robot.description.model import LinkSurface
from robot.trajectory import Trajectory
from tests.helpers.resources import in_proportion
from tests.planners.scenes import scene, thing

RADII_M = (0.001, 0.006)
HOME = np.zeros(6)

# A point counts as in the material beyond this winding number, and as outside below the other: screw holes and the
# gaps between the triangles of the published meshes are in between.
IN_MATERIAL, OUTSIDE = 0.8, 0.2


@pytest.fixture(scope="module")
def links(robot):
    """The surface of each link that moves, and its place at the joints' zero."""
    model = pin.buildModelFromXML(kinematic_urdf(robot))
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    loaded = dict(surfaces.load_surfaces(robot.surfaces, model))
    joints = {name: model.frames[model.getFrameId(name)].parentJoint for name in loaded}
    return {name: (surface, data.oMi[joints[name]]) for name, surface in loaded.items() if joints[name] > 0}


def drawn(surface: surfaces.TriangleSurface, random: np.random.Generator) -> np.ndarray:
    """A point of the box around a surface [m]."""
    return random.uniform(*surface.box_m)


def winding_number(links, point_m: np.ndarray) -> float:
    """How often the surface of a link winds around a point of the arm's frame [m], at most."""
    here = [(surface, place.actInv(point_m)) for surface, place in links.values()]
    # Beside its box a surface winds around nothing.
    inside = [(surface, at) for surface, at in here if np.all((at > surface.box_m[0]) & (at < surface.box_m[1]))]
    return max((abs(surface.winding_number(at)) for surface, at in inside), default=0.0)


@pytest.mark.parametrize("radius_m", RADII_M)
def test_a_sphere_in_the_material_of_a_link_is_in_contact_however_small_it_is(changing, links, radius_m) -> None:
    random, found = np.random.default_rng(round(1e6 * radius_m)), 0
    while found < in_proportion(40):
        surface, place = list(links.values())[random.integers(len(links))]
        point_m = drawn(surface, random)
        if abs(surface.winding_number(point_m)) > IN_MATERIAL:
            found += 1
            changing.set_scene(scene(thing(Sphere(radius_m), *place.act(point_m).tolist())))
            assert changing.collides(HOME), place.act(point_m)


@pytest.mark.parametrize("shape", [Cylinder(0.001, 0.001), Mesh(*ball(0.001, 8))], ids=["Cylinder", "Mesh"])
def test_a_small_body_of_any_shape_inside_a_link_is_in_contact_with_it(changing, links, shape) -> None:
    random = np.random.default_rng(2)
    for name, (surface, place) in links.items():
        changing.set_scene(scene(thing(shape, *place_in_the_material(surface, place, random))))
        assert {"thing", name} in [pair.links for pair in changing.colliding_pairs(HOME)]


@pytest.mark.parametrize("radius_m", RADII_M)
def test_a_sphere_outside_of_every_link_is_free(changing, links, radius_m) -> None:
    random, found = np.random.default_rng(round(1e6 * radius_m)), 0
    # Steps that leave no gap between the directions for a link's edge.
    directions = np.vstack([ball(1.0, 12)[0], np.zeros((1, 3))])
    while found < in_proportion(10):
        surface, place = list(links.values())[random.integers(len(links))]
        point_m = place.act(drawn(surface, random))
        around_m = point_m + (radius_m + 0.002) * directions
        clear_m = min(
            np.linalg.norm(each._vertices_m - at.actInv(point_m), axis=1).min() for each, at in links.values()
        )
        if clear_m > radius_m + 0.004 and all(winding_number(links, near_m) < OUTSIDE for near_m in around_m):
            found += 1
            changing.set_scene(scene(thing(Sphere(radius_m), *point_m.tolist())))
            touched = [pair for pair in changing.colliding_pairs(HOME) if "base_link" not in (pair.first, pair.second)]
            assert touched == [], point_m


def place_in_the_material(surface: surfaces.TriangleSurface, place, random: np.random.Generator) -> list[float]:
    """Draw a place inside a surface, more than 2 mm from its vertices [m]."""
    while True:
        point_m = drawn(surface, random)
        clear_m = np.linalg.norm(surface._vertices_m - point_m, axis=1).min()
        if clear_m > 0.002 and surface.encloses(point_m.reshape(1, 1, 3)):
            return place.act(point_m).tolist()


def test_a_small_body_inside_a_link_touches_it_attached_and_along_a_motion(robot, arm, changing, links) -> None:
    place_m = place_in_the_material(*links["gripper_link"], np.random.default_rng(2))
    changing.set_scene(scene(attached=(AttachedObject(thing(Sphere(0.001), *place_m), robot.root_link),)))
    assert {"thing", "gripper_link"} in [pair.links for pair in changing.colliding_pairs(HOME)]
    changing.set_scene(scene(thing(Sphere(0.001), *place_m)))
    # The surface moves by 0.02 mm at most, so it never touches the sphere.
    start, end, rest = np.zeros(5), np.array([0.0, 0.0, 0.0, 0.0, 1e-4]), np.zeros((2, 5))
    space = JointSpace(changing, arm.joints, HOME)
    assert not space.free(start)
    assert not line_free(space, end, start)
    contact = certify(space, Trajectory(arm.joints, np.array([0.0, 0.1]), np.array([start, end]), rest, rest))
    assert contact is not None
    assert contact.time_s == 0.0


def test_a_winding_number_is_one_inside_of_a_ball_and_none_outside() -> None:
    vertices_m, triangles = ball(0.05, 60)
    half = len(triangles) // 2
    # Turn the half that faces inwards.
    triangles[half:] = triangles[half:, ::-1]
    vertices, packed = surfaces.packed(vertices_m, triangles)
    surface = surfaces.TriangleSurface(surfaces.UNIT_M * vertices, packed)
    random, middle_m = np.random.default_rng(1), 0.5 * sum(surface.box_m)
    for distance_m, expected in ((0.02, 1.0), (0.045, 1.0), (0.055, 0.0), (0.2, 0.0)):
        for direction in random.normal(size=(in_proportion(30), 3)):
            point_m = middle_m + distance_m * direction / np.linalg.norm(direction)
            assert abs(surface.winding_number(point_m)) == pytest.approx(expected, abs=0.05)
    beside_m, inside_m = middle_m + np.array([0.06, 0.0, 0.0]), middle_m + np.array([0.01, 0.0, 0.0])
    assert not surface.encloses(np.array([[beside_m]]))
    assert surface.encloses(np.array([[beside_m], [inside_m]]))
    assert not surface.encloses(np.array([[inside_m, beside_m]])), "a body that sticks out"
    mirrored = surfaces.TriangleSurface(surface._vertices_m, surface._triangles[:, ::-1])
    assert mirrored.encloses(np.array([[inside_m]]))


def test_each_body_of_a_surface_has_its_outermost_points_and_packing_drops_what_is_twice_or_flat() -> None:
    vertices_m, triangles = ball(0.05, 12)
    two_m = np.vstack([vertices_m, vertices_m + np.array([0.2, 0.0, 0.0])])
    both = np.vstack([triangles, triangles + len(vertices_m)]).astype(np.int32)
    surface = surfaces.TriangleSurface(two_m, both)
    assert surface.points_m.shape == (2, 6, 3)
    # In any order of the vertices, of which one is in no triangle.
    order = np.random.default_rng(1).permutation(len(two_m) + 1)
    mixed = surfaces.TriangleSurface(np.vstack([two_m, np.ones(3)])[order], np.argsort(order)[both].astype(np.int32))
    for extreme in (np.min, np.max):
        of_balls = [extreme(ball_m, axis=0) for ball_m in np.split(two_m, 2)]
        assert sorted(extreme(mixed.points_m, axis=1).tolist()) == sorted(map(np.ndarray.tolist, of_balls))
    assert (np.ptp(surface.points_m, axis=1) > 0.09).all(), "outermost points of one body each"
    assert np.ptp(surface.points_m[:, 0, 0]) > 0.1
    vertices = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 1e-7, 0.0]])
    _, triangles = surfaces.packed(vertices, np.array([[0, 1, 2], [2, 0, 1], [0, 3, 2], [0, 1, 3]]))
    assert len(triangles) == 1


def test_a_file_that_is_none_of_surfaces_is_named(tmp_path, robot) -> None:
    path, pin_model = tmp_path / "surfaces.npz", pin.buildModelFromXML(kinematic_urdf(robot))
    vertices, triangle = np.zeros((3, 3), np.int16), np.array([[0, 1, 2]], np.int32)
    whole, endless = io.BytesIO(), io.BytesIO()
    np.savez(whole, **{"boom.vertices": vertices, "boom.triangles": triangle})
    with zipfile.ZipFile(endless, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("boom.triangles.npy", bytes(2 * MAX_SURFACES_BYTES))
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<i4", "fortran_order": False, "shape": (1 << 50, 3)})
    asks_for_all = io.BytesIO()
    with zipfile.ZipFile(asks_for_all, "w") as archive:
        archive.writestr("boom.vertices.npy", header.getvalue())
    for content, problem in (
        (b"no numbers", "cannot be read"),
        (whole.getvalue()[:-30], "cannot be read"),
        (whole.getvalue().replace(b"\x02\x00\x00\x00", b"\x01\x00\x00\x00", 1), "cannot be read"),
        (endless.getvalue(), "unpacks to 100000"),
        (asks_for_all.getvalue(), "cannot be read"),
        ({"boom.vertices": np.full((3, 3), np.nan), "boom.triangles": triangle}, "integers"),
        ({"boom.vertices": vertices, "boom.triangles": triangle.astype(float)}, "integers"),
        ({"other.vertices": vertices}, "cannot be read"),
        ({"boom.vertices": vertices, "boom.triangles": np.zeros((0, 3), np.int32)}, "shape (n, 3)"),
        ({"boom.vertices": vertices[:, :2], "boom.triangles": np.zeros((1, 3), np.int32)}, "shape (n, 3)"),
        ({"boom.vertices": vertices, "boom.triangles": np.full((1, 3), 3, np.int32)}, "without vertices"),
    ):
        if isinstance(content, bytes):
            path.write_bytes(content)
        else:
            np.savez(path, **content)
        with pytest.raises(ShapeError) as error:
            list(surfaces.load_surfaces({"boom": LinkSurface(path, "boom")}, pin_model))
        assert problem in str(error.value)
        assert str(path) in str(error.value)
