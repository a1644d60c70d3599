"""Paths on which UR5's tip turns, judged by the one path of its six joints: exact inverse kinematics, step by step."""

import numpy as np
import pinocchio as pin
import pytest

from planners.geometry.shapes import as_pose
from planners.problem import CartesianPlan, CartesianProblem, Line
from planners.scene import Pose
from tests.planners.test_published_arms import Arm, pytestmark  # noqa: F401 - skips where no arm is installed

STEPS = 400

# Further from the exact path than an orientation tolerance of 0.02 rad explains is another branch.
SAME_BRANCH_RAD = 0.2


@pytest.fixture(scope="module")
def ur5():
    return Arm("ur5")


def follow(arm, q, end):
    problem = CartesianProblem(
        arm.group, arm.named(q), arm.tip, (Line(end),), keep_orientation=True, avoid_collisions=False
    )
    plan = arm.planner.answer(problem)
    assert isinstance(plan, CartesianPlan), plan
    return plan


def pose(arm, q):
    arm.forward.place(q)
    return arm.forward.placement(arm.tip).copy()


def exact(arm, q, end):
    """Return the joints along a line to a pose by Newton's method, None past a singularity or a joint's limit."""
    start, points = pose(arm, q), [q]
    turn = pin.log3(start.rotation.T @ end.rotation)
    for share in np.linspace(0.0, 1.0, STEPS)[1:]:
        rotation = start.rotation @ pin.exp3(share * turn)
        q = q.copy()
        for _ in range(3):
            here = pose(arm, q)
            error_m = start.translation + share * (end.translation - start.translation) - here.translation
            error_rad = here.rotation @ pin.log3(here.rotation.T @ rotation)
            step = np.linalg.lstsq(arm.forward.jacobian(q, arm.tip), np.concatenate((error_m, error_rad)))[0]
            q += step
            if np.abs(step).max() > 0.2 or np.any((q < arm.collision.lower_rad) | (q > arm.collision.upper_rad)):
                return None
        points.append(q)
    return np.array(points)


def moved(arm, seed):
    """Return a random start and an end: turned in place, moved, or both, by turns."""
    rng = np.random.default_rng(seed)
    q = arm.state(rng)
    start, way_m, turn = pose(arm, q), rng.normal(size=3), rng.normal(size=3)
    way_m *= (seed % 3 != 0) * rng.uniform(0.02, 0.25) / np.linalg.norm(way_m)
    turn *= (seed % 3 != 1) * rng.uniform(0.2, 2.2) / np.linalg.norm(turn)
    return q, pin.SE3(start.rotation @ pin.exp3(turn), start.translation + way_m)


def test_the_tip_turns_in_place_by_two_radians(ur5):
    q = np.array([-0.042, 0.033, -2.174, 5.282, -1.528, 0.0])
    assert follow(ur5, q, Pose((0.3, 0.1, 0.5))).fraction == 1.0


# Seeds 18 to 57 have exact paths that were refused, and 45 is stopped by a singularity.
@pytest.mark.parametrize("seed", [0, 1, 2, 18, 24, 31, 33, 35, 42, 45, 54, 57])
def test_a_path_is_followed_on_the_branch_of_its_start_or_not_to_its_end(ur5, seed):
    q, end = moved(ur5, seed)
    plan, points = follow(ur5, q, as_pose(end)), exact(ur5, q, end)
    assert (plan.fraction == 1.0) == (points is not None and seed != 45)
    for point in plan.trajectory.positions_rad if points is not None else ():
        assert np.min(np.max(np.abs(points - point), axis=1)) < SAME_BRANCH_RAD
