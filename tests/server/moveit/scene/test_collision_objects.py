"""Collision objects as moveit_msgs/CollisionObject describes them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.scene import Box, Cone, Cylinder, Plane, Pose, Sphere
from planners.scene_checks import MAX_TRIANGLES
from server.moveit.scene import collision_objects as shapes
from server.moveit.scene.collision_objects import (
    BOX,
    CONE,
    CYLINDER,
    MAX_PRISM_CORNERS,
    MAX_SUBFRAMES,
    PRISM,
    SPHERE,
    prism_mesh,
    read_collision_object,
    read_mesh,
    read_plane,
    read_primitive,
)
from tests.helpers.moveit import box, collision_object, pose, rejection

BALL = {"type": 2, "dimensions": [0.1]}
QUARTER = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
RICH = collision_object(
    id="rack",
    header={"frame_id": "base_link"},
    pose=pose(1.0, 2.0, 3.0, turned=QUARTER),
    type={"key": "furniture", "db": "{}"},
    primitives=[{"type": 1, "dimensions": [1.0, 2.0, 3.0]}, BALL],
    primitive_poses=[pose(0.1), pose(0.2, turned=QUARTER)],
    planes=[{"coef": [0.0, 0.0, 1.0, 0.5]}],
    plane_poses=[pose(0.0, 0.0, 0.3)],
    subframe_names=["hook"],
    subframe_poses=[pose(0.0, 0.4)],
)


def test_an_object_is_written_as_it_was_read_and_without_a_pose_has_that_of_its_single_shape():
    thing = read_collision_object(RICH, "base_link", "it")
    assert thing.message == RICH
    assert [type(shape) for shape, _ in thing.shapes] == [Box, Sphere, Plane]
    assert [at.position_m[0] for _, at in thing.shapes] == [0.1, 0.2, 0.0]
    assert thing.scene_object.pose.position_m == (1.0, 2.0, 3.0)
    assert thing.subframes == {"hook": Pose((0.0, 0.4, 0.0))}
    thing = read_collision_object(collision_object(**box("b"), primitive_poses=[pose(0.3)]), "", "it")
    assert thing.pose == Pose((0.3, 0.0, 0.0))
    assert thing.shapes[0][1] == Pose()


CROWD = {"subframe_names": ["a"] * (MAX_SUBFRAMES + 1), "subframe_poses": [pose()] * (MAX_SUBFRAMES + 1)}
BAD = [
    ({"primitives": []}, "has no shape"),
    ({"pose": pose(math.nan)}, "it.pose.position.x must be a finite number, not nan"),
    ({"pose": pose(1e6)}, "beyond 100 m"),
    ({"primitive_poses": [pose(0.0, math.inf)]}, "it.primitive_poses[0].position.y"),
    ({"primitive_poses": [pose(), pose()]}, "it.primitive_poses has 2 entries, primitives only 1"),
    ({"mesh_poses": [pose()]}, "it.mesh_poses has 1 entries, meshes only 0"),
    ({"primitives": [{"type": 2, "dimensions": [0.0]}]}, "it.primitives[0] is a sphere"),
    ({"subframe_names": ["a"]}, "subframe_names has 1 entries, subframe_poses 0"),
    ({"subframe_names": [""], "subframe_poses": [pose()]}, "it.subframe_names[0] is ''"),
    ({"subframe_names": ["a", "a"], "subframe_poses": [pose()] * 2}, "it.subframe_names[1] is 'a'"),
    ({"subframe_names": ["a"], "subframe_poses": [pose(math.nan)]}, "it.subframe_poses[0]"),
    (CROWD, f"more than {MAX_SUBFRAMES}"),
]


@pytest.mark.parametrize(("fields", "words"), BAD)
def test_a_bad_value_is_rejected_with_object_and_field(fields, words):
    refusal = rejection(read_collision_object, collision_object(**{**box("odd one"), **fields}), "", "it")
    assert words in refusal.message
    assert "'odd one'" in refusal.message
    assert refusal.details["object"] == "odd one"


TRIANGLE = [{"x": 0.0, "y": 0.0, "z": 0.0}, {"x": 1.0, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 1.0, "z": 0.0}]
FLAT = [{"x": float(x), "y": 0.0, "z": 0.0} for x in range(3)]


def primitive(kind, *dimensions, points=()):
    corners = [{"x": point[0], "y": point[1], "z": 9.0} for point in points]
    return {"type": kind, "dimensions": list(dimensions), "polygon": {"points": corners}}


def mesh(vertices, *triangles):
    return {"vertices": vertices, "triangles": [{"vertex_indices": list(each)} for each in triangles]}


def test_a_primitive_is_read_by_its_type_a_prism_as_a_mesh_and_a_plane_with_a_unit_normal():
    for message, shape in (
        (primitive(BOX, 1.0, 2.0, 3.0), Box((1.0, 2.0, 3.0))),
        (primitive(SPHERE, 0.1), Sphere(0.1)),
        (primitive(SPHERE, 0.1, 0.0, 0.0), Sphere(0.1)),
        (primitive(CYLINDER, 0.5, 0.1), Cylinder(radius_m=0.1, height_m=0.5)),
        (primitive(CONE, 0.5, 0.1), Cone(radius_m=0.1, height_m=0.5)),
    ):
        assert read_primitive(message, "it") == shape
    assert len(read_primitive(primitive(PRISM, 0.5, points=[(0, 0), (1, 0), (0, 1)]), "it").triangles) == 8
    assert read_plane({"coef": [0.0, 0.0, 2.0, -1.0]}, "it") == Plane((0.0, 0.0, 1.0), 0.5)


TINY = (0, 1, 2)
BAD_SHAPES = [
    (read_primitive, primitive(9, 1.0), "it.type must be one of 1 (box)"),
    (read_primitive, primitive(BOX, 1.0, 1.0), "it.dimensions of a box are 3, not 2"),
    (read_primitive, primitive(BOX, 1.0, 1.0, 0.0), "sizes are not all above 0"),
    (read_primitive, primitive(SPHERE, -1.0), "sizes are not all above 0"),
    (read_primitive, primitive(CYLINDER, math.nan, 1.0), "sizes are not all above 0"),
    (read_primitive, primitive(PRISM, 1.0, points=[(0, 0), (1, 0)]), "has 2 points, not 3 to 100"),
    (read_primitive, primitive(PRISM, 0.0, points=[(0, 0), (1, 0), (0, 1)]), "must be above 0, not 0"),
    (read_primitive, primitive(PRISM, 1.0, points=[(math.nan, 0), (1, 0), (0, 1)]), "not finite"),
    (read_primitive, primitive(PRISM, 1.0, points=[(0, 0), (2, 2), (2, 0), (0, 2)]), "crosses itself"),
    (read_primitive, primitive(PRISM, 1.0, points=[(0, 0), (1, 1), (2, 2)]), "crosses itself or has no area"),
    (read_mesh, mesh(TRIANGLE), "mesh of 0 triangles"),
    (read_mesh, mesh([]), "mesh of 0 triangles"),
    (read_mesh, mesh(TRIANGLE, (0, 1, 3)), "name the vertex 3; there are 3"),
    (read_mesh, mesh(TRIANGLE, (0, 1, 2**32 - 1)), "name the vertex 4294967295"),
    (read_mesh, mesh(TRIANGLE, *([TINY] * (MAX_TRIANGLES + 1))), f"{MAX_TRIANGLES} triangles are"),
    (read_mesh, mesh(FLAT, TINY), "triangles have no area"),
    (read_plane, {"coef": [0.0, 0.0, 0.0, 1.0]}, "it.coef has no normal"),
    (read_plane, {"coef": [math.nan, 0.0, 1.0, 1.0]}, "it.coef has no normal"),
    (read_plane, {"coef": [0.0, 0.0, 1.0, math.inf]}, "offset is not finite"),
]


@pytest.mark.parametrize(("read", "message", "words"), BAD_SHAPES)
def test_a_bad_shape_is_rejected_with_its_field(read, message, words):
    refusal = rejection(read, message, "it")
    assert words in refusal.message
    assert refusal.message.startswith("it")


def volume_m3(mesh):
    """By the divergence theorem, above 0 when every triangle is seen counter-clockwise from outside."""
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def spiral(corners):
    """A polygon between two spirals, of whose corners few are ears."""
    inner, outer = (
        [((r + 0.1 * k) * math.cos(0.3 * k), (r + 0.1 * k) * math.sin(0.3 * k)) for k in range(corners // 2)]
        for r in (1.0, 1.3)
    )
    return [*inner, *reversed(outer)]


def test_the_most_corners_of_a_prism_take_few_searches_for_ears(monkeypatch):
    searches = []
    is_ear = shapes._is_ear
    monkeypatch.setattr(shapes, "_is_ear", lambda *arguments: searches.append(1) or is_ear(*arguments))
    assert prism_mesh(spiral(MAX_PRISM_CORNERS), 1.0) is not None
    assert len(searches) < 4 * MAX_PRISM_CORNERS


@given(st.lists(st.floats(0.5, 2.0), min_size=3, max_size=12), st.booleans())
def test_a_star_of_any_radii_is_closed_and_keeps_its_area(radii_m, clockwise):
    angles = np.linspace(0.0, 2.0 * math.pi, len(radii_m), endpoint=False)
    polygon = [(r * math.cos(a), r * math.sin(a)) for r, a in zip(radii_m, angles, strict=True)]
    following = [*polygon[1:], polygon[0]]
    area_m2 = 0.5 * sum(x * v - u * y for (x, y), (u, v) in zip(polygon, following, strict=True))
    surface = prism_mesh(polygon[::-1] if clockwise else polygon, 1.0)
    assert volume_m3(surface) == pytest.approx(area_m2)
    edges = [tuple(t[[i, (i + 1) % 3]]) for t in surface.triangles for i in range(3)]
    assert len(set(edges)) == len(edges)
    assert all((b, a) in edges for a, b in edges)
