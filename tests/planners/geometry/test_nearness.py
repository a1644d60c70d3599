import numpy as np
import pytest

from planners.geometry.collision import CollisionModel
from planners.scene import Box, Plane, Pose, Scene, SceneObject, Sphere

WITHIN_M = 0.15
BALLS = Scene(
    7101,
    (
        SceneObject("left", ((Sphere(0.03), Pose((0.25, 0.15, 0.2))),)),
        SceneObject("above", ((Sphere(0.05), Pose((0.1, 0.0, 0.4))),)),
        SceneObject("far", ((Box((0.1, 0.1, 0.1)), Pose((1.0, 1.0, 1.0))),)),
        SceneObject("floor", ((Plane((0.0, 0.0, 1.0), -0.1), Pose()),)),
    ),
)


@pytest.fixture(scope="module")
def among_balls(robot):
    model = CollisionModel(robot)
    assert model.set_scene(BALLS) is None
    return model


def near(model, q):
    return {(pair.first, pair.second): pair for pair in model.near_pairs(q, WITHIN_M)}


def test_near_pairs_are_found_and_far_ones_are_not(among_balls):
    found = near(among_balls, np.zeros(6))
    assert all(pair.distance_m < WITHIN_M for pair in found.values())
    assert any("left" in names for names in found)
    assert not any("far" in names for names in found)


def test_links_and_objects_are_told_apart(among_balls):
    found = near(among_balls, np.array([0.0, -1.0, 1.5, 0.5, 0.0, 0.0]))
    for (_, second), pair in found.items():
        assert pair.by_object == (second in ("left", "above", "floor"))
    assert any(not pair.by_object for pair in found.values())


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


def test_two_that_overlap_get_apart_against_the_slope(robot):
    model = CollisionModel(robot)
    model.set_scene(Scene(7102, (SceneObject("floor", ((Plane((0.0, 0.0, 1.0), 0.0), Pose()),)),)))
    q = np.array([0.0, 1.2, -0.4, 0.6, 0.0, 0.0])
    deep = min(model.near_pairs(q, WITHIN_M), key=lambda pair: pair.distance_m)
    assert deep.distance_m < 0.0
    moved = near(model, q + 0.01 * deep.distance_gradient / np.linalg.norm(deep.distance_gradient))
    assert moved[deep.first, deep.second].distance_m > deep.distance_m
