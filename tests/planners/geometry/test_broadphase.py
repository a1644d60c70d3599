import numpy as np
import pinocchio as pin
import pytest

from planners.geometry.broadphase import Broadphase
from planners.geometry.pairs import Rules, links_of, standing
from planners.geometry.shapes import robot_shapes
from planners.geometry.skeleton import kinematic_urdf
from tests.planners.scenes import around_the_arm

STATES = 150


@pytest.fixture(params=[1, 2])
def crowded(request, robot):
    """The arm among things of every shape, and states of it."""
    model = pin.buildModelFromXML(kinematic_urdf(robot))
    scene = around_the_arm(request.param)
    movers, around = links_of(model, robot_shapes(robot, model), scene), list(standing(scene, 1.0))
    pairs = Rules(robot, {}).pairs(movers, around)

    def build(apart_m):
        return Broadphase(model, [body.shape for body in (*movers, *around)], pairs, np.full(len(pairs), apart_m))

    limits = model.lowerPositionLimit, model.upperPositionLimit
    return build, np.random.default_rng(3).uniform(*limits, (STATES, model.nq))


def distances_m(broadphase, pairs, q):
    broadphase.place(q)
    return np.array([broadphase.distance_m(pair) for pair in range(pairs)])


def test_touching_is_overlapping(crowded):
    build, states = crowded
    broadphase, verdicts = build(0.0), set()
    for q in states:
        broadphase.place(q)
        assert broadphase.touches(q) == bool(broadphase.touching())
        verdicts.add(broadphase.touches(q))
    assert verdicts == {True, False}


@pytest.mark.parametrize("margin_m", [0.0, 0.003, 0.02, 0.1])
def test_near_is_nearer_than_the_margin(crowded, margin_m):
    build, states = crowded
    broadphase = build(0.0)
    count = len(broadphase._pairs)
    for q in states:
        apart_m = distances_m(broadphase, count, q)
        # Distances of touching meshes are those of single triangles.
        if np.abs(apart_m - margin_m).min() > 1e-5:
            near = np.flatnonzero(apart_m < margin_m).tolist()
            assert broadphase.near(q, np.full(count, margin_m)) == near
            assert broadphase.near_among(q, range(0, count, 2), np.full(count, margin_m)) == [
                pair for pair in near if pair % 2 == 0
            ]


def test_each_pair_has_a_margin_of_its_own(crowded):
    build, states = crowded
    broadphase = build(0.0)
    count = len(broadphase._pairs)
    margins_m = np.random.default_rng(4).uniform(0.0, 0.1, count)
    for q in states:
        slack_m = distances_m(broadphase, count, q) - margins_m
        if np.abs(slack_m).min() > 1e-5:
            assert broadphase.near(q, margins_m) == np.flatnonzero(slack_m < 0.0).tolist()


def test_what_must_stay_apart_touches_before_it_overlaps(crowded):
    build, states = crowded
    plain, padded = build(0.0), build(0.02)
    count = len(plain._pairs)
    for q in states:
        apart_m = distances_m(plain, count, q)
        if abs(apart_m.min() - 0.02) > 1e-5:
            assert padded.touches(q) == (apart_m.min() < 0.02)
        np.testing.assert_allclose(distances_m(padded, count, q), apart_m - 0.02, atol=1e-9)
