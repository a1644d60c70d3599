import numpy as np
import pytest

from planners.assistant.decomposition import Limits, decompose
from planners.assistant.surface import merged
from tests.helpers.stl_arm import boxes_union, channel


def surface(triangles):
    return merged(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


@pytest.fixture(scope="module")
def of_channel():
    return decompose(surface(channel()), Limits())


def test_parts_cover_a_hollow_link_within_the_tolerance_and_leave_its_hollow_free(of_channel):
    assert 1 < len(of_channel.parts) <= 12
    assert of_channel.deviation.greatest_m <= 0.003
    vertices, hollow = channel().reshape(-1, 3), np.array([[0.01, 0.0, 0.1]])
    assert np.min([part.depth_m(vertices) for part in of_channel.parts], axis=0).max() < 1e-9
    assert min(part.depth_m(hollow).item() for part in of_channel.parts) > 0.005


def test_a_convex_mesh_is_one_part():
    found = decompose(surface(boxes_union([((0.0, 0.0, 0.0), (0.1, 0.2, 0.3))])), Limits())
    assert len(found.parts) == 1
    assert found.deviation.greatest_m < 0.003


def test_the_same_seed_gives_the_same_parts(of_channel):
    again = decompose(surface(channel()), Limits())
    assert all(
        np.array_equal(first.vertices_m, second.vertices_m)
        for first, second in zip(of_channel.parts, again.parts, strict=True)
    )


def test_bounds_give_the_closest_parts_and_their_deviation():
    assert len(decompose(surface(channel()), Limits(max_time_s=0.0)).parts) == 1
    found = decompose(surface(channel()), Limits(max_parts=1))
    assert len(found.parts) == 1
    assert found.deviation.outside_m == pytest.approx(0.016, abs=0.0005)
