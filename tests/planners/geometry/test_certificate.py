import itertools

import numpy as np
import pytest

from planners.errors import StoppedError
from planners.geometry.certificate import certify
from planners.geometry.collision import CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.scene import Box
from robot.trajectory import Trajectory
from tests.helpers.resources import in_proportion
from tests.planners.scenes import around_the_arm, scene, thing

READY = np.array([0.0, -0.5, 0.5, 0.0, 0.0])


@pytest.fixture(scope="module")
def own_collision(robot):
    """One whose scene may change."""
    return CollisionModel(robot)


@pytest.fixture
def space_in(own_collision, arm):
    def build(surroundings, **arguments):
        assert own_collision.set_scene(surroundings) is None
        return JointSpace(own_collision, arm.joints, np.zeros(6), **arguments)

    return build


def motion(names, points, period_s=0.1):
    """A smooth motion through points that rests in its ends."""
    points = np.asarray(points, dtype=float)
    times_s = period_s * np.arange(len(points))
    velocities = np.gradient(points, period_s, axis=0) if len(points) > 1 else np.zeros_like(points)
    velocities[[0, -1]] = 0.0
    return Trajectory(names, times_s, points, velocities, np.zeros_like(points))


def only_hulls_touch(collision, q):
    return collision.hull_only_pairs(q) and not collision.colliding_pairs(q)


def turn(arm, *pans_rad):
    return motion(arm.joints, [READY + np.array([pan, 0.0, 0.0, 0.0, 0.0]) for pan in pans_rad])


def test_a_wall_thinner_than_the_way_between_samples_is_found(space_in, arm):
    # The samples, 40 cm apart at the tip, are free.
    space = space_in(scene(thing(Box((0.4, 0.001, 0.4)), 0.4, 0.0, 0.2)))
    trajectory = turn(arm, -1.2, -0.9, 0.9, 1.2)
    assert all(space.free(point) for point in trajectory.positions_rad)
    contact = certify(space, trajectory)
    assert "thing" in {name for pair in contact.pairs for name in pair.links}
    assert 0.1 < contact.time_s < 0.2


def test_contact_in_the_start_is_told_at_time_zero_and_in_the_end_later(space_in, arm):
    space = space_in(scene(thing(Box((0.1, 0.1, 0.1)), 0.3, 0.0, 0.2)))
    assert certify(space, turn(arm, 0.0, 1.0)).time_s == 0.0
    assert certify(space, turn(arm, 0.0)).time_s == 0.0
    assert certify(space, turn(arm, 1.2, 0.0)).time_s > 0.0


def test_the_first_of_several_contacts_is_told(space_in, arm):
    places = {"right": -0.8, "left": 0.8}
    walls = [thing(Box((0.02, 0.02, 0.4)), 0.3 * np.cos(a), 0.3 * np.sin(a), 0.2, name=n) for n, a in places.items()]
    space = space_in(scene(*walls))
    # The arm turns against its joint's sense.
    for pans, name in (((0.0, 1.7), "right"), ((0.0, -1.7), "left"), ((1.7, -1.7), "right"), ((-1.7, 1.7), "left")):
        contact = certify(space, turn(arm, *pans))
        assert name in {name for pair in contact.pairs for name in pair.links}
        assert contact.time_s < 0.07


@pytest.mark.parametrize("seed", [0, 1, 6])
def test_certified_motions_are_free_at_a_finer_step(space_in, own_collision, arm, seed):
    rng = np.random.default_rng(seed)
    space = space_in(around_the_arm(seed))
    for _ in range(in_proportion(10)):
        points = rng.uniform(0.4 * space.lower_rad, 0.4 * space.upper_rad, (3, 5))
        trajectory = motion(arm.joints, points)
        verdict = certify(space, trajectory)
        touching = [t for t in np.linspace(0.0, 0.2, 800) if not space.free(trajectory.sample(t)[0])]
        if verdict is None:
            assert not touching
        else:
            assert not space.free(trajectory.sample(verdict.time_s)[0])
            assert not touching or touching[0] >= verdict.time_s - 0.02


def test_if_only_hulls_touch_the_parts_decide(own_collision, space_in, arm, robot):
    rng = np.random.default_rng(5)
    space = space_in(scene(thing(Box((0.05, 0.05, 0.3)), 0.25, 0.1, 0.15)))
    points = rng.uniform(0.6 * space.lower_rad, 0.6 * space.upper_rad, (1000, 5))
    tight = [point for point in points if only_hulls_touch(own_collision, np.append(point, 0.0))]
    assert tight
    for point in tight[:10]:
        fresh = space_in(scene(thing(Box((0.05, 0.05, 0.3)), 0.25, 0.1, 0.15)))
        assert not fresh.free(point)
        assert certify(fresh, motion(arm.joints, [point])) is None
        assert fresh.free(point)


def test_a_certificate_is_given_up_when_its_request_is_cancelled(own_collision, space_in, arm):
    rng = np.random.default_rng(5)
    box = scene(thing(Box((0.05, 0.05, 0.3)), 0.25, 0.1, 0.15))
    free = space_in(box)
    points = rng.uniform(0.6 * free.lower_rad, 0.6 * free.upper_rad, (1000, 5))
    tight = next(point for point in points if only_hulls_touch(own_collision, np.append(point, 0.0)))
    asked = itertools.count()
    space = space_in(box, also_free=[np.append(tight, 0.0)], should_stop=lambda: next(asked) == 2)
    with pytest.raises(StoppedError):
        certify(space, motion(arm.joints, [tight, tight + 0.01, tight]))
