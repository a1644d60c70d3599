"""Shapes, and collisions between them."""

import math
import struct
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.errors import ShapeError
from planners.geometry import collision as collision_module
from planners.geometry import shapes
from planners.geometry.collision import DEPTH_ACCURACY_M, CollisionModel
from planners.geometry.shapes import convex, enclosing, kinematic_urdf
from planners.scene import EMPTY_SCENE, AttachedObject, Box, Mesh, Plane, Pose, Scene, SceneObject
from robot.description import model
from tests.helpers.resources import examples, in_proportion
from tests.planners.scenes import CORNERS_M, FACES, SHAPES, around_the_arm, outside_m, scene, thing, tip_positions_m
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF, stl

NEAR_CUBE, POST = (
    thing(Box((0.1,) * 3), 0.3, 0.0, 0.0, name="cube"),
    thing(Box((0.1, 0.1, 0.5)), 0.3, 0.3, 0.0, name="post"),
)
FINGERS = frozenset({"moving_jaw_so101_v1_link"})
HELD = AttachedObject(SceneObject("bar", ((Box((0.02, 0.02, 0.1)), Pose()),)), "gripper_link", FINGERS)
GRIPPER_AND_WRIST = frozenset({"gripper_link", "wrist_link"})
FOLDED_TOO_FAR = {"shoulder_lift": -1.745, "elbow_flex": 1.69, "wrist_flex": 1.0}
HOME = np.zeros(6)


def in_scene(robot, each):
    model = CollisionModel(robot)
    model.set_scene(each)
    return model


@pytest.fixture
def checked(robot):
    """Pairs of names that are checked in a scene."""
    hulls_alone = replace(robot, parts={}, surfaces={})
    return lambda each: set(in_scene(hulls_alone, each)._names)


def test_a_scene_that_cannot_be_built_leaves_none_and_the_next_is_built_whole(robot, monkeypatch):
    model, free, blocked = CollisionModel(robot), scene(), scene(POST)
    for each in (free, blocked):
        model.set_scene(free)
        with monkeypatch.context() as patch:
            patch.setattr(collision_module, "approach", lambda *_: 1 / 0)
            with pytest.raises(ZeroDivisionError):
                model.set_scene(scene(NEAR_CUBE))
        assert model.set_scene(each) is None
        assert model.in_collision(HOME) == in_scene(robot, each).in_collision(HOME)


def test_links_are_checked_but_for_neighbours_and_disabled_pairs_unless_these_are_said_to_be_forbidden(robot, checked):
    neighbours = {frozenset((joint.parent, joint.child)) for joint in robot.joints.values()}
    every = {frozenset((a, b)) for a in robot.hulls for b in robot.hulls if a != b}
    assert checked(EMPTY_SCENE) == every - neighbours - robot.disabled_pairs
    assert GRIPPER_AND_WRIST not in checked(EMPTY_SCENE)
    assert GRIPPER_AND_WRIST in checked(Scene(1, allowed={GRIPPER_AND_WRIST: False}))


def test_an_attached_object_is_checked_against_what_it_may_not_touch_and_an_allowed_pair_is_not(robot, checked):
    pairs = checked(Scene(1, (NEAR_CUBE,), (HELD,)))
    others = {*robot.hulls, "cube"} - {"gripper_link", *FINGERS}
    assert {pair for pair in pairs if "bar" in pair} == {frozenset(("bar", name)) for name in others}
    for names in (("cube", "wrist_link"), ("shoulder_link", "gripper_link"), ("bar", "cube")):
        allowed = Scene(1, (NEAR_CUBE,), (HELD,), allowed={frozenset(names): True})
        assert pairs - checked(allowed) == {frozenset(names)}


def state(collision, **positions_rad):
    return np.array([positions_rad.get(name, 0.0) for name in collision.joint_names])


@pytest.fixture(scope="module")
def collision(robot):
    """One that knows the hulls only, so that every way to ask has the same answer."""
    return CollisionModel(replace(robot, parts={}))


def test_no_verdict_depends_on_what_was_asked_before(robot, collision):
    # The search for a common point starts from hints that earlier questions left behind.
    rng = np.random.default_rng(3)
    other = CollisionModel(replace(robot, parts={}))
    for q, asked_before in rng.uniform(collision.lower_rad, collision.upper_rad, (in_proportion(8_000), 2, 6)):
        other.colliding_pairs(asked_before)
        assert bool(collision.colliding_pairs(q)) == bool(other.colliding_pairs(q))


def test_named_states_touch_nothing_and_colliding_pairs_name_the_links_deepest_first(robot, collision):
    for name, positions_rad in robot.named_states["arm"].items():
        for jaw_rad in (-0.17, 0.0, 1.7):
            assert not collision.in_collision(state(collision, **positions_rad, gripper=jaw_rad)), name
    pairs = collision.colliding_pairs(state(collision, **FOLDED_TOO_FAR))
    assert {"shoulder_link", "lower_arm_link"} in [pair.links for pair in pairs]
    depths_m = [pair.depth_m for pair in pairs]
    assert depths_m == sorted(depths_m, reverse=True)
    assert 0.0 < depths_m[0] < 0.03
    # Figures of the official description at all joints zero.
    tip_m = tip_positions_m(collision, [HOME], "gripper_frame_link")[0]
    np.testing.assert_allclose(tip_m, (0.391, 0.0, 0.226), atol=1e-3)


def test_things_of_every_shape_are_touched_by_name(changing, robot):
    for shape in SHAPES:
        # The gripper is there at home, but for the plane, which is below.
        place_m = (0.0, 0.0, 1.0) if isinstance(shape, Plane) else (0.35, 0.0, 0.2)
        assert changing.set_scene(scene(thing(shape, *place_m))) is None
        pairs = [pair for pair in changing.colliding_pairs(HOME) if "thing" in pair.links]
        assert "gripper_link" in {name for pair in pairs for name in pair.links}, shape
        assert changing.in_collision(HOME), shape
    changing.set_scene(scene(thing(Box((3.0, 3.0, 3.0)))))
    touching = {name for pair in changing.colliding_pairs(HOME) for name in pair.links}
    assert touching == {"thing", *robot.hulls} - {robot.root_link}
    # A room of triangles is free inside, and a table in the plane of the base is no contact with the base.
    changing.set_scene(scene(thing(Mesh(30.0 * (CORNERS_M - 0.02), FACES))))
    assert not changing.colliding_pairs(HOME)
    changing.set_scene(scene(thing(Plane((0.0, 0.0, 1.0), 0.0))))
    assert not changing.colliding_pairs(HOME)
    assert changing.in_collision(state(changing, shoulder_lift=1.7))


def test_an_attached_object_moves_with_its_link_and_extends_the_reach(changing):
    long_bar = thing(Box((0.02, 0.02, 0.3)), 0.0, 0.0, 0.2)
    bar = AttachedObject(long_bar, "gripper_frame_link", frozenset({"gripper_link"}))
    empty_handed = changing.travel_m_per_rad
    post = thing(Box((0.05, 0.05, 0.05)), 0.65, 0.0, 0.226, name="post")
    changing.set_scene(scene(post))
    assert not changing.in_collision(HOME)
    changing.set_scene(scene(post, attached=(bar,)))
    assert {"thing", "post"} in [pair.links for pair in changing.colliding_pairs(HOME)]
    assert np.all(changing.travel_m_per_rad >= empty_handed)
    assert changing.travel_m_per_rad[0] > empty_handed[0] + 0.1


def test_padding_and_scale_make_contacts_with_objects_only_and_a_contact_is_where_both_things_are(changing):
    box = thing(Box((0.1, 0.1, 0.1)), 0.5, 0.0, 0.2)
    changing.set_scene(scene(box))
    assert not changing.in_collision(HOME)
    changing.set_scene(scene(box, link_padding_m={"gripper_link": 0.1}))
    (pair,) = changing.colliding_pairs(HOME)
    assert pair.links == {"gripper_link", "thing"}
    assert 0.0 < pair.depth_m < 0.1
    # Scaled links meet objects in their new size, and links in their own.
    changing.set_scene(scene(box, link_scale={"gripper_link": 3.0}))
    assert [pair.links for pair in changing.colliding_pairs(HOME)] == [{"gripper_link", "thing"}]
    changing.set_scene(scene(thing(Box((0.1, 0.1, 0.1)), 0.42, 0.0, 0.226)))
    (pair,) = [pair for pair in changing.colliding_pairs(HOME) if "gripper_link" in pair.links]
    assert np.all(np.abs(np.array(pair.point_m) - (0.42, 0.0, 0.226)) <= 0.05 + pair.depth_m)
    assert np.linalg.norm(pair.normal) == pytest.approx(1.0)


def test_contacts_by_parts_are_contacts_by_hulls_and_overlaps_those_of_the_parts_where_they_are_less_deep(changing):
    changing.set_scene(around_the_arm(2))
    verdicts = set()
    for q in np.random.default_rng(4).uniform(changing.lower_rad, changing.upper_rad, (150, 6)):
        verdicts.add((bool(changing.colliding_pairs(q)), changing.in_collision(q)))
        for refined in (changing.hull_only_pairs(q), {frozenset(("base_link", "gripper_link"))}):
            by_parts = changing.in_collision(q, frozenset(changing.pairs_of(refined)))
            assert by_parts == bool(changing.colliding_pairs(q, refined))
    assert (True, False) not in verdicts
    assert (False, True) in verdicts
    changing.set_scene(scene(thing(Box((0.1, 0.1, 0.1)), 0.38, 0.0, 0.16)))
    shallower = 0
    for q in np.random.default_rng(3).normal(0.0, 0.15, (60, 6)):
        by_hulls_m = {pair.links: pair.depth_m for pair in changing.colliding_pairs(q)}
        overlaps_m = changing.overlaps_m(q)
        assert overlaps_m.keys() == by_hulls_m.keys()
        assert all(overlaps_m[links] <= by_hulls_m[links] + DEPTH_ACCURACY_M for links in overlaps_m)
        shallower += sum(overlaps_m[links] < by_hulls_m[links] - 0.001 for links in overlaps_m)
    assert shallower


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


def test_flat_points_get_a_thin_plate_and_a_corner_with_hundreds_of_neighbours_is_enclosed():
    for flat in ((1.0, 1.0, 0.0), (1.0, 1.0, 1e-9), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)):
        points = CUBE * flat
        hull = convex(points)
        assert outside_m(hull, points).max() < 0.0, flat
        assert np.max(np.ptp(hull.points(), axis=0) - np.ptp(points, axis=0)) <= 2.0 * shapes.PLATE_M + 1e-12, flat
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


NEEDLE_M = np.array([(0, 0, 0), (0.3, 0, 0), (0, 0.02, 0), (0, 0, 0.02)])
TETRAHEDRON = stl(NEEDLE_M[FACES]).encode()


def test_meshes_beside_the_urdf_are_replaced_by_hulls_and_one_gone_or_unreadable_is_refused_in_one_line(tmp_path):
    for name in ("boom.stl", f"package://{tmp_path.name}/boom.stl"):
        found = shapes_of(crane(tmp_path, TETRAHEDRON, name))
        boom = next(shape for shape in found if shape.name.startswith("boom"))
        assert isinstance(boom.geometry, coal.Convex)
        assert len(shapes.outline(boom)) == 4
    robot = crane(tmp_path, TETRAHEDRON)
    (tmp_path / "boom.stl").unlink()
    with pytest.raises(ShapeError, match=r"boom\.stl"):
        shapes_of(robot)
    with pytest.raises(ShapeError, match=r": cannot be loaded: Could not load resource \S+/boom\.stl [^\n]+$"):
        shapes_of(crane(tmp_path, bytes(200)))
    numbers = struct.pack("<12fH", *[math.nan] * 12, 0)
    with pytest.raises(ShapeError, match=r"a vertex of \S+/boom\.stl is no finite number$"):
        shapes_of(crane(tmp_path, bytes(80) + struct.pack("<I", 1) + numbers))
    # So is a robot without any shape.
    bare = model.parse(kinematic_urdf(model.parse(CRANE_URDF, CRANE_SRDF)), CRANE_SRDF)
    with pytest.raises(ShapeError, match="no link has a collision shape"):
        shapes_of(bare)


def test_a_scaled_shape_grows_about_its_middle_and_a_plane_is_solid_below():
    for shape in (coal.Box(0.1, 0.2, 0.3), convex(np.random.default_rng(1).normal(size=(20, 3)))):
        larger = shapes.scaled(shape, 1.5)
        for each in (shape, larger):
            each.computeLocalAABB()
        middle = 0.5 * (shape.aabb_local.min_ + shape.aabb_local.max_)
        for end in ("min_", "max_"):
            grown, before = (getattr(each.aabb_local, end) - middle for each in (larger, shape))
            np.testing.assert_allclose(grown, 1.5 * before, atol=1e-9)
    for normal in ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 2.0, -2.0)):
        box, place = shapes.solid(Plane(normal, 0.3), 1.0)
        up = np.array(normal) / np.linalg.norm(normal)
        for height_m, inside in ((0.299, True), (0.301, False), (-1.0, True)):
            for beside_m in np.random.default_rng(1).uniform(-1.0, 1.0, (10, 3)):
                point = height_m * up + beside_m - up * (beside_m @ up)
                assert np.all(np.abs(place.actInv(point)) <= 0.5 * np.array(2.0 * box.halfSide)) == inside
