import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given

from planners.cartesian.following import CHORD_M, CORNER_STEP_M, ON_PATH_M, PathEnd, PathFollower
from planners.cartesian.tip_path import TipPath, apart_m
from tests.helpers.resources import examples
from tests.planners.following import line, shares
from tests.planners.invariants import never

START = np.array([0.0, -0.5, 0.7, 0.4, 0.0])


def following(follower, start, segments, check_point=lambda point: None, should_stop=never, **asked):
    tracker = follower.tracker(start)
    path = TipPath(tracker.pose(start), segments)
    names = follower.robot.groups["arm"].joints
    heeded = {"max_step_m": 0.005, "max_joint_step_rad": 0.0, "orientation_tolerance_rad": np.inf} | asked
    return PathFollower(tracker, names, path, check_point=check_point, should_stop=should_stop, **heeded)


def shifted(follower, *offset_m):
    placement = follower.pose(START)
    return line(pin.SE3(placement.rotation, placement.translation + np.array(offset_m)))


@given(share=shares, near=shares)
@examples(20)
def test_points_lie_on_the_path_no_further_apart_than_asked(follower, share, near):
    start = follower.point(0.8 * share)
    task = following(follower, start, [line(follower.pose(follower.near(start, near)))])
    followed = task.from_point(start)
    assert np.diff(followed.along_m).max(initial=0.0) <= 0.005 + 1e-9
    for along_m, point in zip(followed.along_m, followed.points, strict=True):
        assert apart_m(task.path.at(along_m), task.tracker.pose(point)) <= ON_PATH_M


@given(share=shares, near=shares)
@examples(20)
def test_straight_joint_lines_between_points_stay_near_the_path(follower, share, near):
    start = follower.point(0.8 * share)
    task = following(follower, start, [line(follower.pose(follower.near(start, near)))])
    followed = task.from_point(start)
    for i in range(len(followed.points) - 1):
        halfway = task.tracker.pose(0.5 * (followed.points[i] + followed.points[i + 1]))
        assert apart_m(task.path.at(0.5 * (followed.along_m[i] + followed.along_m[i + 1])), halfway) <= CHORD_M


def test_a_path_within_reach_is_followed_to_its_end(follower):
    task = following(follower, START, [shifted(follower, 0.0, 0.05, 0.02)])
    followed = task.from_point(START)
    assert followed.ended is None
    assert followed.along_m[-1] == pytest.approx(task.path.length_m)


def test_a_point_lies_in_each_corner_and_close_ones_beside_it(follower):
    task = following(follower, START, [shifted(follower, 0.0, 0.05, 0.0), shifted(follower, 0.0, 0.05, -0.05)])
    along_m = task.from_point(START).along_m
    corner = int(np.argmin(np.abs(along_m - 0.05)))
    assert along_m[corner] == pytest.approx(0.05, abs=1e-12)
    assert np.diff(along_m)[corner - 1] <= 1.5 * CORNER_STEP_M
    assert np.diff(along_m)[corner] <= 3.0 * CORNER_STEP_M


def test_the_end_of_reach_is_told_with_the_distance_left(follower):
    ended = following(follower, START, [shifted(follower, 0.6, 0.0, 0.0)]).from_point(START).ended
    assert ended.reason == "reach"
    assert 0.3 < ended.details["distance_m"] < 0.6


def test_an_orientation_that_cannot_be_kept_ends_the_path(follower):
    task = following(follower, START, [shifted(follower, 0.0, 0.1, 0.0)], orientation_tolerance_rad=0.1)
    ended = task.from_point(START).ended
    assert ended.reason == "orientation"
    assert ended.details["deviation_rad"] > 0.1


def test_a_joint_step_beyond_the_threshold_ends_the_path_and_is_named(follower):
    task = following(follower, START, [shifted(follower, 0.0, 0.05, 0.0)], max_joint_step_rad=1e-4)
    ended = task.from_point(START).ended
    assert ended.reason == "jump"
    assert ended.details["joint"] in task.joint_names
    assert ended.details["step_rad"] > 1e-4


def test_a_flaw_ends_the_path_at_its_first_point(follower):
    limit_rad = START[0] - 0.1
    flaw = PathEnd("constraint", "too far to the right", {})
    task = following(
        follower,
        START,
        [shifted(follower, 0.0, 0.1, 0.0)],
        check_point=lambda point: flaw if point[0] < limit_rad else None,
    )
    followed = task.from_point(START)
    assert followed.ended is flaw
    assert limit_rad <= followed.points[-1][0] < limit_rad + 0.003


def test_following_stops_when_told_to(follower):
    task = following(follower, START, [shifted(follower, 0.0, 0.1, 0.0)], should_stop=lambda: True)
    assert len(task.from_point(START).points) == 1
