from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest

from harness.meshes import ball
from planners.geometry.broadphase import FEW_SHAPES, MANY_RESTING, UNKNOWN_M
from planners.geometry.certificate import line_free
from planners.geometry.collision import CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.geometry.parts import Boxes, PartPair, least_distance_m, near_pairs, parts_of
from planners.geometry.shapes import convex, frame_of_link, kinematic_urdf
from planners.geometry.surfaces import UNIT_M, load_surfaces
from planners.scene import AttachedObject, Box, Mesh, Plane, Pose, SceneObject, Sphere
from robot.description import model
from tests.helpers.resources import in_proportion
from tests.planners.scenes import CORNERS_M, FACES, around_the_arm, outside_m, scene, thing
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF, stl

STATES = 30
HOME = np.zeros(6)


@pytest.fixture
def crowded(robot):
    """The arm among things of every shape, and states of it."""

    def build():
        model = CollisionModel(robot)
        model.set_scene(around_the_arm(2))
        return model._broadphase

    limits = [[getattr(joint, end) for joint in robot.movable_joints] for end in ("lower", "upper")]
    return build, np.random.default_rng(3).uniform(*limits, (STATES, len(limits[0])))


def distances_m(broadphase, q):
    broadphase.place(q)
    return np.array([broadphase.distance_m(pair) for pair in range(len(broadphase._pairs))])


@pytest.mark.parametrize("many_resting", [0, MANY_RESTING])
@pytest.mark.parametrize("few", [0, FEW_SHAPES])
def test_touching_is_overlapping_among_few_and_many_shapes(crowded, monkeypatch, few, many_resting):
    build, states = crowded
    monkeypatch.setattr("planners.geometry.broadphase.FEW_SHAPES", few)
    monkeypatch.setattr("planners.geometry.broadphase.MANY_RESTING", many_resting)
    broadphase, fresh, verdicts = build(), build(), set()
    for q in states:
        expected = fresh.touching(q)
        assert broadphase.touches(q) == bool(expected)
        assert broadphase.touches(q, frozenset(expected[1:])) == bool(expected)
        assert not broadphase.touches(q, frozenset(expected)), "these are left out"
        assert list(broadphase.touching_among(q, range(len(broadphase._pairs)))) == expected
        # What was found before, elsewhere and among some of the pairs, leaves nothing behind.
        assert broadphase.touching(q) == expected == np.flatnonzero(distances_m(broadphase, q) < 0.0).tolist()
        alone = broadphase.near_among(q, range(0, len(broadphase._pairs), 2), np.zeros(len(broadphase._pairs[::2])))
        assert [pair for pair, _ in alone] == [i for i in expected if i % 2 == 0]
        verdicts.add(bool(expected))
    assert verdicts == {True, False}


@pytest.mark.parametrize("few", [0, FEW_SHAPES])
def test_padded_links_and_a_held_object_touch_each_of_many_objects(changing, monkeypatch, few):
    monkeypatch.setattr("planners.geometry.broadphase.FEW_SHAPES", few)
    rng, padding_m = np.random.default_rng(7), {"gripper_link": 0.05, "lower_arm_link": 0.01}
    held = AttachedObject(SceneObject("bar", ((Box((0.02, 0.02, 0.2)), Pose()),), Pose()), "gripper_link", frozenset())
    places_m = rng.uniform((-0.5, -0.5, 0.0), (0.5, 0.5, 0.6), (2 * MANY_RESTING, 3)).tolist()
    things = (thing(Box((0.02, 0.02, 0.02)), *at_m, name=str(at_m)) for at_m in places_m)
    assert changing.set_scene(scene(*things, attached=(held,), link_padding_m=padding_m)) is None
    broadphase, touched = changing._broadphase, set()
    for q in rng.uniform(changing.lower_rad, changing.upper_rad, (in_proportion(1000), 6)):
        expected = np.flatnonzero(distances_m(broadphase, q) < 0.0).tolist()
        assert broadphase.touches(q) == bool(expected)
        # Each pair alone, and none in spite of all others.
        for pair in expected[:3]:
            others = frozenset(range(len(broadphase._pairs))) - {pair}
            assert broadphase.touches(q, others)
            touched |= changing._names[pair]
    assert {"bar", *padding_m} <= touched


@pytest.mark.parametrize("margins_m", [(0.02, 0.02), (0.0, 0.1)], ids=str)
def test_near_is_nearer_than_the_margin_of_each_pair(crowded, margins_m):
    build, states = crowded
    broadphase = build()
    count = len(broadphase._pairs)
    margins_m = np.random.default_rng(4).uniform(*margins_m, count)
    for q in states:
        slack_m = distances_m(broadphase, q) - margins_m
        # Distances of touching meshes are those of single triangles.
        if np.abs(slack_m).min() > 1e-5:
            near = np.flatnonzero(slack_m < 0.0).tolist()
            found = dict(broadphase.near(q, margins_m))
            assert list(found) == near
            alone = broadphase.near_among(q, range(0, count, 2), margins_m[::2])
            assert [pair for pair, _ in alone] == [pair for pair in near if pair % 2 == 0]
            known_m = slack_m + margins_m
            for pair, clearance_m in (*found.items(), *alone):
                assert (clearance_m <= 0.0) == (known_m[pair] <= 0.0)
                if pair in broadphase._triangles:
                    assert clearance_m <= max(UNKNOWN_M, known_m[pair])
                elif clearance_m > 0.0:
                    assert clearance_m == pytest.approx(known_m[pair], abs=2e-6)


def test_a_ball_of_triangles_has_nearly_the_clearance_of_a_solid_one_and_no_more_than_its_own(robot, crowded):
    (_, states), near = crowded, 0
    mesh, solid = (CollisionModel(robot) for _ in range(2))
    mesh.set_scene(scene(thing(Mesh(*ball(0.05, 60)), 0.3, 0.0, 0.2)))
    solid.set_scene(scene(thing(Sphere(0.05), 0.3, 0.0, 0.2)))
    margins_m = np.full(len(mesh.approach_m_per_rad), 0.2)
    for q in states:
        own_m, clearances_m = distances_m(mesh._broadphase, q), dict(solid.near(q, margins_m))
        for pair, clearance_m in mesh.near(q, margins_m):
            assert clearance_m <= max(own_m[pair], UNKNOWN_M) + 1e-6
            if clearances_m[pair] > 0.003:
                assert clearance_m > clearances_m[pair] - 0.002
                near += pair in mesh._broadphase._triangles
    assert near > STATES


# Two small tetrahedra at the ends of the boom: between them is only their hull.
TRIANGLES_M = [0.2 * CORNERS_M[face] + (far_m, 0.0, 0.0) for far_m in (0.0, 0.28) for face in FACES]
BETWEEN = frozenset(("boom", "thing"))


@pytest.fixture
def crane(tmp_path):
    """A crane with a boom of which only the ends are there."""
    (tmp_path / "boom.stl").write_text(stl(TRIANGLES_M))
    shape = '<origin xyz="0.15 0 0"/><geometry><box size="0.3 0.02 0.02"/></geometry>'
    assert shape in CRANE_URDF
    urdf = CRANE_URDF.replace(shape, '<geometry><mesh filename="boom.stl"/></geometry>')
    return model.parse(urdf, CRANE_SRDF, mesh_directory=tmp_path)


def pose(rng, reach_m):
    return pin.SE3(pin.Quaternion(*rng.normal(size=4)).normalized(), rng.uniform(-reach_m, reach_m, 3))


def boxes(rng, count):
    return [
        pin.GeometryObject(str(i), 0, 0, pose(rng, 0.3), coal.Box(*rng.uniform(0.01, 0.1, 3))) for i in range(count)
    ]


def distance_m(one, at_one, other, at_other):
    places = at_one * one.placement, at_other * other.placement
    first, second = (coal.Transform3s(place.rotation, place.translation) for place in places)
    asked, found = coal.DistanceRequest(), coal.DistanceResult()
    return coal.distance(one.geometry, first, other.geometry, second, asked, found)


def test_boxes_of_two_joints_are_near_if_they_touch_and_no_nearer_than_their_bound():
    rng, verdicts = np.random.default_rng(2), set()
    for _ in range(40):
        between = pose(rng, 0.1)
        middles_m, halves_m = (rng.uniform(low_m, high_m, (2, 6, 3)) for low_m, high_m in ((-0.2, 0.2), (0.01, 0.08)))
        first, second = map(Boxes.between, middles_m - halves_m, middles_m + halves_m)
        of_first, of_second = (
            [
                pin.GeometryObject("", 0, 0, pin.SE3(np.eye(3), at), coal.Box(*size))
                for at, size in zip(*each, strict=True)
            ]
            for each in zip(middles_m, 2.0 * halves_m, strict=True)
        )
        apart_m = [[distance_m(one, pin.SE3.Identity(), other, between) for other in of_second] for one in of_first]
        near = near_pairs(first, second, between, 0.0).tolist()
        assert sorted(near) == np.argwhere(np.array(apart_m) < 0.0).tolist()
        assert np.all(least_distance_m(first, second, between) <= np.array(apart_m) + 1e-6)
        verdicts.add(bool(near))
    assert verdicts == {True, False}


@pytest.mark.parametrize("margin_m", [0.0, 0.01, 0.05])
def test_parts_are_nearer_than_a_margin_when_any_two_of_them_are(margin_m):
    rng, verdicts = np.random.default_rng(1), set()
    for _ in range(60):
        first, second = boxes(rng, 4), boxes(rng, 3)
        at_first, at_second = pose(rng, 0.2), pose(rng, 0.2)
        nearest_m = min(distance_m(one, at_first, other, at_second) for one in first for other in second)
        pair = PartPair(parts_of(first), at_first, parts_of(second), at_second)
        near = pair.nearer_than(margin_m)
        verdicts.add(near)
        if abs(nearest_m - margin_m) > 1e-5:
            assert near == (nearest_m < margin_m)
        assert pair.nearest().distance_m == pytest.approx(nearest_m, abs=1e-5)
        for depth_m in (-0.05, 0.0, 0.02):
            assert abs(nearest_m + depth_m) < 1e-5 or pair.deeper_than(depth_m) == (nearest_m < -depth_m)
    assert verdicts == {True, False}


def test_the_folded_arm_is_free_by_its_parts_which_are_there_before_they_are_needed(robot, collision, monkeypatch):
    for jaw_rad in (0.35, 0.0):
        q = np.array([0.0, -1.745, 1.55, 0.9, 0.0, jaw_rad])
        assert not collision.colliding_pairs(q)
        assert JointSpace(collision, robot.groups["arm"].joints, q).free(q[:5])
    blocked = CollisionModel(robot)
    blocked.set_scene(scene(thing(Box((0.1, 0.1, 0.1)), 0.38, 0.0, 0.16)))
    monkeypatch.setattr("planners.geometry.parts.convex", None)
    assert blocked.colliding_pairs(HOME)


def test_parts_and_hulls_of_the_builtin_arm_cover_its_surfaces(robot):
    pin_model = pin.buildModelFromXML(kinematic_urdf(robot))
    rng = np.random.default_rng(1)
    for link, surface in load_surfaces(robot.surfaces, pin_model):
        place = pin_model.frames[frame_of_link(pin_model, link)].placement
        # Uniform on each of some triangles.
        triangles_m = surface._vertices_m[rng.choice(surface._triangles, in_proportion(500))]
        points_m = np.einsum("ij,ijk->ik", rng.dirichlet((1.0, 1.0, 1.0), len(triangles_m)), triangles_m)
        points_m = (points_m - place.translation) @ place.rotation
        for covering in (robot.parts[link], [robot.hulls[link].vertices]):
            assert np.min([outside_m(convex(part), points_m) for part in covering], axis=0).max() < UNIT_M


def with_part(crane):
    """The crane whose boom has a hull and a part, both around the whole of its mesh."""
    vertices = np.asarray(convex(np.array(TRIANGLES_M).reshape(-1, 3)).points())
    boom = model.Hull(vertices, np.zeros((0, 3), dtype=np.int32))
    return replace(crane, hulls={"boom": boom}, parts={"boom": (vertices,)})


# The boom is 27 cm up, with nothing in its middle. There the faces of cube and hull are parallel: without any margin
# coal misses that the hull overlaps the cube by 14 mm.
CUBE, BALL = Box((0.02, 0.02, 0.02)), Sphere(0.001)
IN_THE_MIDDLE, AT_THE_END = (0.15, 0.01, 0.28), (0.285, 0.005, 0.275)


@pytest.mark.parametrize(
    ("change", "put", "contact", "only_hulls"),
    [
        (None, thing(CUBE, *IN_THE_MIDDLE), False, True),
        (None, thing(CUBE, *AT_THE_END), True, False),
        (None, thing(BALL, *AT_THE_END), True, False),
        (None, thing(BALL, 0.27, 0.005, 0.275), False, None),
        (with_part, thing(CUBE, *IN_THE_MIDDLE), True, False),
        (lambda crane: replace(with_part(crane), mesh_directory=None), thing(CUBE, *AT_THE_END), True, False),
    ],
    ids=[
        *("only the hull", "the mesh", "wholly in the mesh", "wholly beside the mesh"),
        *("a part beside its mesh", "a part without its mesh"),
    ],
)
def test_parts_decide_where_the_hull_of_a_link_touches(crane, change, put, contact, only_hulls):
    collision, q = CollisionModel(change(crane) if change else crane), np.zeros(3)
    collision.set_scene(scene(put))
    assert collision.collides(q) == contact
    assert [pair.links for pair in collision.colliding_pairs(q)] == [BETWEEN] * contact
    if only_hulls is not None:
        assert collision.in_collision(q)
        assert collision.hull_only_pairs(q) == ({BETWEEN} if only_hulls else set())
        refined = frozenset(collision.pairs_of(collision.hull_only_pairs(q)))
        assert collision.in_collision(q, refined) == contact


def test_a_motion_out_of_a_gap_is_judged_by_the_mesh_and_padding_counts_between_meshes_too(crane):
    collision = CollisionModel(crane)
    collision.set_scene(scene(thing(CUBE, *IN_THE_MIDDLE)))
    joints, start = crane.groups["arm"].joints, np.zeros(3)
    lifted, extended, elsewhere = np.array([(0.0, -0.3, 0.0), (0.0, 0.0, 0.1), (1.0, 0.0, 0.0)])
    space = JointSpace(collision, joints, start)
    assert space.free(start)
    assert line_free(space, start, lifted)
    assert line_free(space, start, extended)
    assert not JointSpace(collision, joints, elsewhere).free(start)
    assert JointSpace(collision, joints, elsewhere, also_free=[start]).free(start)
    collision.set_scene(scene(thing(CUBE, *IN_THE_MIDDLE), link_padding_m={"boom": 0.2}))
    assert BETWEEN in [pair.links for pair in collision.colliding_pairs(np.zeros(3))]


WITHIN_M = 0.15


@pytest.fixture
def among_balls(changing):
    left, above = thing(Sphere(0.03), 0.25, 0.15, 0.2, name="left"), thing(Sphere(0.05), 0.1, 0.0, 0.4, name="above")
    far = thing(Box((0.1, 0.1, 0.1)), 1.0, 1.0, 1.0, name="far")
    floor = thing(Plane((0.0, 0.0, 1.0), -0.1), name="floor")
    assert changing.set_scene(scene(left, above, far, floor)) is None
    return changing


def near(model, q):
    return {(pair.first, pair.second): pair for pair in model.near_pairs(q, WITHIN_M)}


def test_near_pairs_are_found_far_ones_are_not_and_links_and_objects_are_told_apart(among_balls):
    found = near(among_balls, HOME)
    assert all(pair.distance_m < WITHIN_M for pair in found.values())
    assert any("left" in names for names in found)
    assert not any("far" in names for names in found)
    found = near(among_balls, np.array([0.0, -1.0, 1.5, 0.5, 0.0, 0.0]))
    for (_, second), pair in found.items():
        assert pair.by_object == (second in ("left", "above", "floor"))
    assert any(not pair.by_object for pair in found.values())
    # Two that overlap get apart against the slope.
    among_balls.set_scene(scene(thing(Plane((0.0, 0.0, 1.0), 0.0), name="floor")))
    q = np.array([0.0, 1.2, -0.4, 0.6, 0.0, 0.0])
    deep = min(among_balls.near_pairs(q, WITHIN_M), key=lambda pair: pair.distance_m)
    assert deep.distance_m < 0.0
    moved = near(among_balls, q + 0.01 * deep.distance_gradient / np.linalg.norm(deep.distance_gradient))
    assert moved[deep.first, deep.second].distance_m > deep.distance_m


@pytest.mark.parametrize("seed", range(4))
def test_the_slope_of_a_distance_is_how_it_grows(among_balls, seed):
    chance = np.random.default_rng(seed)
    q, step = chance.uniform(-0.6, 0.6, 6), 1e-3 * chance.normal(size=6)
    here, there, back = (near(among_balls, q + share * step) for share in (0.0, 1.0, -1.0))
    # Only round things: between flat ones the nearest points jump.
    both = there.keys() & back.keys() & here.keys()
    for names in (names for names in both if names[1] in ("left", "above") and here[names].distance_m > 0.0):
        grown_m = there[names].distance_m - back[names].distance_m
        assert grown_m == pytest.approx(2.0 * here[names].distance_gradient @ step, abs=2e-5)
