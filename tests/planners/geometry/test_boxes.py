from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from planners.geometry.boxes import Boxes, least_distance_m, near_pairs, overlap_m
from tests.helpers.resources import in_proportion

COUNTS = 5, 4


def drawn(rng, count):
    """Boxes of a few centimetres within 12 cm."""
    middles, halves = rng.uniform(-0.06, 0.06, (count, 3)), rng.uniform(0.002, 0.03, (count, 3))
    return Boxes.between(middles - halves, middles + halves)


def drawn_place(rng):
    turn = pin.Quaternion(*rng.normal(size=4)).normalized().matrix()
    return pin.SE3(turn, rng.uniform(-0.06, 0.06, 3))


def distances_m(first, second, between):
    """Distances of the boxes as coal measures them, below 0 how deep they overlap, shape (first, second) [m]."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()

    def solids(boxes, at):
        for middle, half in zip(boxes.middles_m.T, boxes.halves_m.T, strict=True):
            place = at * pin.SE3(np.eye(3), middle)
            yield coal.Box(*(2.0 * half)), coal.Transform3s(place.rotation, place.translation)

    found = []
    for shape, place in solids(first, pin.SE3.Identity()):
        for other, there in solids(second, between):
            result.clear()
            found.append(coal.distance(shape, place, other, there, request, result))
    return np.array(found).reshape(len(first.middles_m.T), len(second.middles_m.T))


@pytest.fixture(params=range(3))
def cases(request):
    rng = np.random.default_rng(request.param)
    return [(drawn(rng, COUNTS[0]), drawn(rng, COUNTS[1]), drawn_place(rng)) for _ in range(in_proportion(20))]


def test_boxes_are_at_least_as_far_apart_as_is_told(cases) -> None:
    for case in cases:
        assert (least_distance_m(*case) <= distances_m(*case) + 1e-6).all()


def test_boxes_along_the_same_axes_are_as_far_apart_as_is_told() -> None:
    rng = np.random.default_rng(5)
    for _ in range(in_proportion(20)):
        case = drawn(rng, COUNTS[0]), drawn(rng, COUNTS[1]), pin.SE3(np.eye(3), rng.uniform(-0.06, 0.06, 3))
        assert np.allclose(least_distance_m(*case), distances_m(*case), atol=1e-6)


def test_boxes_overlap_no_deeper_than_is_told(cases) -> None:
    for case in cases:
        assert (overlap_m(*case) >= -distances_m(*case) - 1e-6).all()


@pytest.mark.parametrize("margin_m", [-0.005, 0.0, 0.004, 0.02])
def test_no_pair_of_boxes_that_is_near_is_missing(cases, margin_m) -> None:
    near = 0
    for case in cases:
        expected = {(i, j) for i, j in np.argwhere(distances_m(*case) < margin_m - 1e-6).tolist()}
        assert expected <= {(i, j) for i, j in near_pairs(*case, margin_m).tolist()}
        near += len(expected)
    assert near


def test_pairs_that_nothing_but_a_corner_keeps_apart_are_few(cases) -> None:
    told = sum(len(near_pairs(*case, 0.0)) for case in cases)
    assert told == sum(int((distances_m(*case) <= 0.0).sum()) for case in cases)


def test_the_pair_that_overlaps_most_comes_first(cases) -> None:
    for case in cases:
        overlaps = overlap_m(*case)
        depths = [overlaps[i, j] for i, j in near_pairs(*case, 0.02).tolist()]
        assert depths == sorted(depths, reverse=True)


def test_the_box_around_all_has_them_on_its_faces(cases) -> None:
    boxes = cases[0][0]
    around = boxes.around
    assert np.allclose(
        around.middles_m - around.halves_m, (boxes.middles_m - boxes.halves_m).min(axis=1, keepdims=True)
    )
    assert np.allclose(
        around.middles_m + around.halves_m, (boxes.middles_m + boxes.halves_m).max(axis=1, keepdims=True)
    )


def test_joints_that_are_far_from_each_other_have_no_near_boxes(cases) -> None:
    first, second, _ = cases[0]
    assert near_pairs(first, second, pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0])), 0.02).shape == (0, 2)
