import numpy as np
import pytest

from planners.assistant.decomposition import Limits, decompose
from planners.assistant.link_shapes import link_surfaces
from planners.assistant.surface import ConvexPart, Surface, measure, merged
from robot.description import model
from tests.helpers import robots
from tests.helpers.stl_arm import boxes_union, channel


def surface(triangles) -> Surface:
    return merged(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


CUBE = surface(boxes_union([((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1))]))


def test_a_part_that_is_too_small_leaves_the_surface_uncovered_and_faces_between_parts_do_not_stand_out():
    deviation = measure(CUBE, [ConvexPart(0.9 * CUBE.vertices_m)], np.random.default_rng(1))
    assert deviation.uncovered_m == pytest.approx(0.01, abs=0.0005)
    assert deviation.outside_m == 0.0
    halves = [((-0.1, -0.1, -0.1), (0.0, 0.1, 0.1)), ((0.0, -0.1, -0.1), (0.1, 0.1, 0.1))]
    parts = [ConvexPart(boxes_union([half]).reshape(-1, 3)) for half in halves]
    # Distances are to samples, which are 1.1 mm apart on this surface.
    assert measure(CUBE, parts, np.random.default_rng(1)).greatest_m < 0.002


def test_a_part_within_planes_encloses_it():
    points, directions = (np.random.default_rng(0).normal(size=(count, 3)) for count in (400, 60))
    wider = ConvexPart(points).within(directions / np.linalg.norm(directions, axis=1)[:, np.newaxis])
    assert wider.depth_m(points).max() < 1e-9


def test_surfaces_of_the_builtin_arm_are_the_official_meshes(robot, shared_data) -> None:
    official = model.load(shared_data / "so101" / "so101_new_calib.urdf", robots.SO101.folder / "so101.srdf")
    expected = link_surfaces(official)
    with np.load(robot.surfaces["base_link"].path) as file:
        assert set(file.files) == expected.keys()
        assert all(np.array_equal(file[name], array) for name, array in expected.items())


def test_parts_cover_a_hollow_link_within_the_tolerance_leave_its_hollow_free_and_are_the_same_by_the_same_seed():
    found, again = (decompose(surface(channel()), Limits()) for _ in range(2))
    assert 1 < len(found.parts) <= 12
    assert found.deviation.greatest_m <= 0.003
    vertices, hollow = channel().reshape(-1, 3), np.array([[0.01, 0.0, 0.1]])
    assert np.min([part.depth_m(vertices) for part in found.parts], axis=0).max() < 1e-9
    assert min(part.depth_m(hollow).item() for part in found.parts) > 0.005
    for first, second in zip(found.parts, again.parts, strict=True):
        np.testing.assert_array_equal(first.vertices_m, second.vertices_m)


def test_a_convex_mesh_is_one_part():
    found = decompose(surface(boxes_union([((0.0, 0.0, 0.0), (0.1, 0.2, 0.3))])), Limits())
    assert len(found.parts) == 1
    assert found.deviation.greatest_m < 0.003


def test_bounds_give_the_closest_parts_and_their_deviation():
    assert len(decompose(surface(channel()), Limits(max_time_s=0.0)).parts) == 1
    found = decompose(surface(channel()), Limits(max_parts=1))
    assert len(found.parts) == 1
    assert found.deviation.outside_m == pytest.approx(0.016, abs=0.0005)
