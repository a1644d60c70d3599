import itertools
import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.errors import StoppedError
from planners.geometry import certificate
from planners.geometry.collision import CollisionModel
from planners.pipeline import Planner
from planners.problem import ConcurrencyQuestion, MoveItErrorCode
from planners.scene import Box
from robot.description import model
from robot.trajectory import Trajectory
from tests.helpers.motions import smooth_move
from tests.helpers.resources import examples, in_proportion
from tests.helpers.robots import LIFTED_SRDF, LIFTED_URDF, PAIR_SRDF, PAIR_URDF
from tests.planners.scenes import around_the_arm, boxes, scene, thing

READY = np.array([0.0, -0.5, 0.5, 0.0, 0.0])
POST = thing(Box((0.05, 0.05, 0.3)), 0.25, 0.1, 0.15)


def motion(names, points, period_s=0.1):
    """A smooth motion through points that rests in its ends."""
    points = np.asarray(points, dtype=float)
    times_s = period_s * np.arange(len(points))
    velocities = np.gradient(points, period_s, axis=0) if len(points) > 1 else np.zeros_like(points)
    velocities[[0, -1]] = 0.0
    return Trajectory(names, times_s, points, velocities, np.zeros_like(points))


@pytest.fixture
def turn(arm):
    """Make a motion that turns the arm from pan to pan."""
    return lambda *pans_rad: motion(arm.joints, [READY + np.array([pan, 0.0, 0.0, 0.0, 0.0]) for pan in pans_rad])


@pytest.fixture
def tight(changing, space_in):
    """Points beside the post at which only hulls touch."""
    space = space_in(scene(POST))
    points = np.random.default_rng(5).uniform(0.6 * space.lower_rad, 0.6 * space.upper_rad, (1000, 5))
    states = ((point, np.append(point, 0.0)) for point in points)
    return [p for p, q in states if changing.hull_only_pairs(q) and not changing.colliding_pairs(q)]


def test_the_first_contact_is_found_with_its_time_also_with_a_wall_thinner_than_the_way_between_samples(space_in, turn):
    # The samples, 40 cm apart at the tip, are free.
    space, trajectory = space_in(scene(thing(Box((0.4, 0.001, 0.4)), 0.4, 0.0, 0.2))), turn(-1.2, -0.9, 0.9, 1.2)
    assert all(space.free(point) for point in trajectory.positions_rad)
    contact = certificate.certify(space, trajectory)
    assert "thing" in {name for pair in contact.pairs for name in pair.links}
    assert 0.1 < contact.time_s < 0.2
    space = space_in(scene(thing(Box((0.1, 0.1, 0.1)), 0.3, 0.0, 0.2)))
    assert certificate.certify(space, turn(0.0, 1.0)).time_s == certificate.certify(space, turn(0.0)).time_s == 0.0
    assert certificate.certify(space, turn(1.2, 0.0)).time_s > 0.0
    places = {"right": -0.8, "left": 0.8}
    walls = [thing(Box((0.02, 0.02, 0.4)), 0.3 * np.cos(a), 0.3 * np.sin(a), 0.2, name=n) for n, a in places.items()]
    space = space_in(scene(*walls))
    # The arm turns against its joint's sense.
    for pans, name in (((0.0, 1.7), "right"), ((0.0, -1.7), "left"), ((1.7, -1.7), "right"), ((-1.7, 1.7), "left")):
        contact = certificate.certify(space, turn(*pans))
        assert name in {name for pair in contact.pairs for name in pair.links}
        assert contact.time_s < 0.07


def test_a_longer_motion_among_many_objects_takes_no_more_memory(space_in, turn):
    space, peaks_bytes = space_in(scene(*boxes(300))), []
    for turns in (5, 25):
        trajectory = turn(*[-1.0, 1.0] * turns)
        tracemalloc.start()
        assert certificate.certify(space, trajectory) is None
        peaks_bytes.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks_bytes[1] < 2 * peaks_bytes[0]


@pytest.mark.parametrize("seed", [0, 1, 6])
def test_certified_motions_are_free_at_a_finer_step(space_in, arm, seed):
    rng, space = np.random.default_rng(seed), space_in(around_the_arm(seed))
    for _ in range(in_proportion(10)):
        trajectory = motion(arm.joints, rng.uniform(0.4 * space.lower_rad, 0.4 * space.upper_rad, (3, 5)))
        verdict = certificate.certify(space, trajectory)
        touching = [t for t in np.linspace(0.0, 0.2, 800) if not space.free(trajectory.sample(t)[0])]
        if verdict is None:
            assert not touching
        else:
            assert not space.free(trajectory.sample(verdict.time_s)[0])
            assert not touching or touching[0] >= verdict.time_s - 0.02


def test_if_only_hulls_touch_the_parts_decide_unless_the_request_is_cancelled(space_in, arm, tight):
    assert tight
    for point in tight[:10]:
        fresh = space_in(scene(POST))
        assert not fresh.free(point)
        assert certificate.certify(fresh, motion(arm.joints, [point])) is None
        assert fresh.free(point)
    point, asked = tight[0], itertools.count()
    space = space_in(scene(POST), also_free=[np.append(point, 0.0)], should_stop=lambda: next(asked) == 2)
    with pytest.raises(StoppedError):
        certificate.certify(space, motion(arm.joints, [point, point + 0.01, point]))


class Discs:
    """A point in a plane among round obstacles: its distance to them is known."""

    travel_m_per_rad = np.array([1.0, 1.0])

    def __init__(self, *discs):
        self.discs = discs
        self.approach_m_per_rad = np.ones((len(discs) + 1, 2))
        self.asked = 0

    def distance(self, point, number=None):
        discs = self.discs if number is None else [self.discs[number]]
        return min((np.hypot(point[0] - x, point[1] - y) - radius for x, y, radius in discs), default=np.inf)

    def free(self, point):
        return self.distance(point) > 0.0

    def near(self, point, margins_m):
        self.asked += 1
        clearances_m = [(number, self.distance(point, number)) for number in range(len(self.discs))]
        return [each for each in clearances_m if each[1] < margins_m[each[0]]]

    def clearance_m(self, number, point, margin_m):
        self.asked += 1
        return min(margin_m, self.distance(point, number))


def line(start, end):
    return certificate.Cubics.line(np.array(start), np.array(end))


def point_on(curve, at):
    """The point of cubic pieces at a place in pieces from the start."""
    i = min(int(at), len(curve.coefficients) - 1)
    u = at - i
    return np.array([(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u**2 * (1 - u), u**3]) @ curve.coefficients[i]


def wavy(seed, pieces=6):
    """Smooth cubic pieces through random points."""
    points, slopes = np.random.default_rng(seed).uniform(-1.0, 1.0, (2, pieces + 1, 2))
    start, end = points[:-1], points[1:]
    return certificate.Cubics(np.stack((start, start + slopes[:-1] / 3.0, end - slopes[1:] / 3.0, end), axis=1))


coordinates = st.floats(-1.0, 1.0)
points = st.tuples(coordinates, coordinates).map(np.array)
discs = st.lists(st.tuples(coordinates, coordinates, st.floats(0.01, 0.3)), max_size=4)


@examples(100)
@given(points, points, discs)
def test_a_line_is_free_when_no_disc_is_on_it(start, end, obstacles):
    around = Discs(*obstacles)
    along = np.linspace(0.0, 1.0, 1001)[:, None]
    nearest = min((around.distance(point) for point in start + along * (end - start)), default=np.inf)
    if around.distance(start) <= 0.0:
        return
    if certificate.line_free(around, start, end):
        assert nearest > -certificate.CHECK_STEP_M
    else:
        assert nearest < certificate.FINEST_STEP_M


@examples(50)
@given(st.integers(0, 10_000), discs)
def test_a_curve_is_free_when_no_disc_is_on_it(seed, obstacles):
    curve, around = wavy(seed), Discs(*obstacles)
    nearest = min(around.distance(point_on(curve, at)) for at in np.linspace(0.0, len(curve.coefficients), 2001))
    at = certificate.first_contact(around, curve, certificate.FINEST_STEP_M)
    if at is None:
        assert nearest > -1e-3 or min(map(around.distance, curve.coefficients[[0, -1], [0, 3]])) <= 0.0
    else:
        assert around.distance(point_on(curve, at)) <= 0.0


@pytest.mark.parametrize(("few_pairs", "looks"), [(2, 20), (1, 10)])
def test_a_way_takes_as_many_checks_as_it_is_close_to_an_obstacle_and_ends_at_the_earliest_contact(
    monkeypatch, few_pairs, looks
):
    monkeypatch.setattr(certificate, "FEW_PAIRS", few_pairs)
    far, close = Discs((0.0, 0.6, 0.1)), Discs((0.0, 0.6, 0.599))
    for around in (far, close):
        assert certificate.first_contact(around, line((-1.0, 0.0), (1.0, 0.0)), certificate.FINEST_STEP_M) is None
    assert far.asked == looks
    assert far.asked < close.asked < 100
    # A coarse step only glances, but the end is looked at all the same.
    around = Discs((0.123, 0.0, 0.0003))
    assert certificate.first_contact(around, line((-1.0, 0.0), (1.0, 0.0)), 0.1) is None
    assert not certificate.line_free(Discs((1.0, 0.0, 0.0001)), np.array([0.0, 0.0]), np.array([1.0, 0.0]))
    around = Discs((-0.5, 0.0, 0.05), (0.0, 0.0, 0.2), (0.7, 0.0, 0.1))
    at = certificate.first_contact(around, line((-1.0, 0.0), (1.0, 0.0)), certificate.FINEST_STEP_M)
    assert -1.0 + 2.0 * at == pytest.approx(-0.55, abs=2.0 * certificate.EARLIEST_STEP_M)


def test_no_joint_moves_further_between_two_places_than_the_bound_of_its_travel():
    curve = wavy(4)
    at = np.linspace(0.0, len(curve.coefficients), 601)
    moved = np.cumsum(np.abs(np.diff([point_on(curve, each) for each in at], axis=0)), axis=0)
    knots = np.arange(len(curve.travelled_rad))
    bounds = np.stack([np.interp(at, knots, joint) for joint in curve.travelled_rad.T], axis=1)
    assert np.all(np.diff(bounds, axis=0) >= np.diff(moved, axis=0, prepend=0.0) - 1e-12)


PAIR = model.parse(PAIR_URDF, PAIR_SRDF)
ZERO = {joint.name: 0.0 for joint in PAIR.movable_joints}


def leaning(side: str, from_rad: float, to_rad: float) -> Trajectory:
    """An upright arm that leans over to the side, its first joint turned so that it leans along y."""
    return smooth_move({f"{side}_a1": (np.pi / 2, np.pi / 2), f"{side}_a2": (from_rad, to_rad)}, 2.0)


def test_motions_that_use_the_same_place_touch_even_at_different_times_and_others_are_free_in_every_position() -> None:
    pair = CollisionModel(PAIR)
    found = certificate.encounter(pair, leaning("left", 0.0, -1.5), leaning("right", 0.0, 1.5), ZERO)
    sides = {frozenset((pair.first[:4], pair.second[:4])) for pair in found.pairs}
    assert frozenset(("left", "righ")) in sides
    assert certificate.encounter(pair, leaning("left", 0.0, -1.5), leaning("right", 1.5, 0.0), ZERO) is not None
    left, right = leaning("left", 0.0, -0.55), leaning("right", 0.0, 0.55)
    assert certificate.encounter(pair, left, right, ZERO) is None
    for first_s, second_s in itertools.product(np.linspace(0.0, 2.0, 9), repeat=2):
        at = dict(zip(left.joint_names, left.sample(first_s)[0], strict=True))
        at |= dict(zip(right.joint_names, right.sample(second_s)[0], strict=True))
        assert not pair.collides(np.array([at.get(name, 0.0) for name in pair.joint_names]))
    # Fingers may move while their own hand does.
    robot = model.parse(LIFTED_URDF, LIFTED_SRDF)
    others = {joint.name: 0.0 for joint in robot.movable_joints}
    fingers = smooth_move({"left_finger_joint": (0.0, 0.05), "right_finger_joint": (0.0, 0.05)}, 1.0)
    assert certificate.encounter(CollisionModel(robot), smooth_move({"a2": (0.0, 0.8)}, 1.0), fingers, others) is None


def test_the_answer_names_what_touches_and_motions_of_one_joint_are_no_question() -> None:
    planner = Planner(PAIR, time.process_time)
    answer = planner.answer(ConcurrencyQuestion(leaning("left", 0.0, -1.5), leaning("right", 0.0, 1.5), ZERO))
    assert all(side in answer.contact.message for side in ("left_", "right_"))
    answer = planner.answer(ConcurrencyQuestion(leaning("left", 0.0, 1.0), leaning("left", 0.0, 1.0), ZERO))
    assert answer.code is MoveItErrorCode.INVALID_MOTION_PLAN
    assert "left_a1" in answer.message
