import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.geometry.certificate import EARLIEST_STEP_M, FINEST_STEP_M, Cubics, first_contact
from planners.geometry.joint_space import JointSpace
from tests.helpers.resources import examples


class Discs:
    """A point in a plane among round obstacles: its distance to them is known."""

    travel_m_per_rad = np.array([1.0, 1.0])
    line_free = JointSpace.line_free

    def __init__(self, *discs):
        self.discs = discs
        self.asked = 0

    def distance(self, point, number=None):
        discs = self.discs if number is None else [self.discs[number]]
        return min((np.hypot(point[0] - x, point[1] - y) - radius for x, y, radius in discs), default=np.inf)

    def free(self, point):
        self.asked += 1
        return self.distance(point) > 0.0

    def candidate_pairs(self, points, joint_travel, among):
        return [
            tuple(
                number
                for number in (range(len(self.discs)) if known is None else known)
                if self.distance(point, number) <= travel.sum()
            )
            for point, travel, known in zip(points, joint_travel, among, strict=True)
        ]

    def touches_any(self, point, among):
        if among is None:
            return not self.free(point)
        return any(self.distance(point, number) <= 0.0 for number in among)


def line(start, end):
    return Cubics(np.array([[np.array(start) + (np.array(end) - start) * share / 3.0 for share in range(4)]]))


def point_on(curve, at):
    """The point of cubic pieces at a place in pieces from the start."""
    i = min(int(at), len(curve) - 1)
    u = at - i
    weights = np.array([(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u**2 * (1 - u), u**3])
    return weights @ curve.coefficients[i]


def wavy(seed, pieces=6):
    """Smooth cubic pieces through random points."""
    rng = np.random.default_rng(seed)
    points, slopes = rng.uniform(-1.0, 1.0, (pieces + 1, 2)), rng.uniform(-1.0, 1.0, (pieces + 1, 2))
    start, end = points[:-1], points[1:]
    return Cubics(np.stack((start, start + slopes[:-1] / 3.0, end - slopes[1:] / 3.0, end), axis=1))


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
    if around.line_free(start, end, FINEST_STEP_M):
        assert nearest > -FINEST_STEP_M
    else:
        assert nearest < FINEST_STEP_M


@examples(50)
@given(st.integers(0, 10_000), discs)
def test_a_curve_is_free_when_no_disc_is_on_it(seed, obstacles):
    curve, around = wavy(seed), Discs(*obstacles)
    nearest = min(around.distance(point_on(curve, at)) for at in np.linspace(0.0, len(curve), 2001))
    at = first_contact(around, curve, FINEST_STEP_M)
    if at is None:
        assert nearest > -1e-3 or min(map(around.distance, curve.coefficients[[0, -1], [0, 3]])) <= 0.0
    else:
        assert around.distance(point_on(curve, at)) <= 0.0


def test_a_coarse_step_only_glances():
    around = Discs((0.123, 0.0, 0.0003))
    assert around.line_free(np.array([-1.0, 0.0]), np.array([1.0, 0.0]), 0.5)
    assert around.asked < 10
    # The end is looked at all the same.
    assert not Discs((1.0, 0.0, 0.0001)).line_free(np.array([0.0, 0.0]), np.array([1.0, 0.0]), 0.5)


def test_the_earliest_of_several_contacts_is_told():
    around = Discs((-0.5, 0.0, 0.05), (0.0, 0.0, 0.2), (0.7, 0.0, 0.1))
    at = first_contact(around, line((-1.0, 0.0), (1.0, 0.0)), FINEST_STEP_M)
    assert -1.0 + 2.0 * at == pytest.approx(-0.55, abs=2.0 * EARLIEST_STEP_M)


def test_a_line_run_through_at_any_speed_is_straight():
    start, end = np.array([0.1, 0.2]), np.array([0.7, -0.4])
    shares = np.array([[0.0, 0.0, 0.1, 0.2], [0.2, 0.3, 0.9, 1.0]])
    assert Cubics(start + shares[:, :, None] * (end - start)).straight()
    overshoots = np.array([[0.0, 0.4, 1.3, 1.0]])
    assert not Cubics(start + overshoots[:, :, None] * (end - start)).straight()
    assert not Cubics(np.zeros((3, 4, 2))).straight()
    assert not wavy(3).straight()
