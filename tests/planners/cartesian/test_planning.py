import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from planners.cartesian.planning import CHORD_M, FollowedPath, tip_curve
from planners.cartesian.tip_path import TipPath, apart_m, arc_flaw
from planners.geometry.shapes import as_pose
from planners.goals import Constraints, JointConstraint, OrientationConstraint
from planners.problem import MoveItErrorCode as Code
from planners.problem import PlanningFailure
from planners.scene import Box
from tests.helpers.resources import examples
from tests.planners.following import TIP, arc, line, shares
from tests.planners.invariants import (
    assert_keeps_positions,
    assert_keeps_rates,
    assert_touches_nothing,
    assert_well_formed,
    fine_samples,
)
from tests.planners.scenes import thing

START = np.array([0.0, -0.5, 0.7, 0.4, 0.0])
# Shares of the joints' ranges where links overlap by nearly as much as a start may.
TOUCHING_ITSELF_BY_4_9_MM = np.array((0.0, 0.0, 0.69, 0.69, 0.0))
FOLDED_INTO_ITSELF = np.array([0.0, -1.74, 1.69, 1.2, 0.0])

# Between the points that are measured the tip may be off by a little more than at them.
BOUND_M = 3e-4


def moved(placement, *offset_m):
    return pin.SE3(placement.rotation, placement.translation + np.array(offset_m))


def shifted(follower, *offset_m):
    return line(moved(follower.pose(START), *offset_m))


def planned(follower, *offset_m, **asked):
    """The plan for a line from the start."""
    return follower.plan(follower.problem(START, shifted(follower, *offset_m), **asked))


def tips_m(follower, plan):
    positions, _, _ = fine_samples(plan.trajectory, per_interval=2)
    return np.array([follower.pose(position).translation for position in positions])


def distance_to_line_m(places_m, start_m, end_m):
    edge = end_m - start_m
    share = np.clip((places_m - start_m) @ edge / (edge @ edge), 0.0, 1.0)
    return np.linalg.norm(places_m - start_m - share[:, np.newaxis] * edge, axis=1)


@given(share=shares, near=shares)
@example(share=TOUCHING_ITSELF_BY_4_9_MM, near=np.array((0.0, 0.0, 0.0, 0.0, 1.0)))
@examples(25)
def test_on_any_line_the_tip_is_on_it_and_the_motion_keeps_every_limit(follower, rate_limits, share, near):
    start = follower.point(share)
    end = follower.pose(follower.near(start, near))
    problem = follower.problem(start, line(end))
    plan = follower.plan(problem)
    if isinstance(plan, PlanningFailure):
        assert plan.code == Code.START_STATE_IN_COLLISION
        return
    assert_well_formed(plan.trajectory)
    assert (plan.fraction == 1.0) == (plan.stopped_by is None)
    if len(plan.trajectory.time_s) == 1:
        return
    assert_keeps_rates(plan.trajectory, rate_limits)
    assert_keeps_positions(plan.trajectory, follower.lower_rad, follower.upper_rad)
    assert_touches_nothing(plan.trajectory, follower.collision, problem.start_rad)
    off_m = distance_to_line_m(tips_m(follower, plan), follower.pose(start).translation, end.translation).max()
    assert off_m <= BOUND_M
    assert off_m <= 1.5 * plan.deviation.position_m + 2e-5


@given(share=shares, near=shares, bulge_m=st.floats(0.005, 0.03))
@examples(15)
def test_on_any_arc_the_tip_stays_on_the_circle(follower, rate_limits, share, near, bulge_m):
    start = follower.point(0.8 * share)
    begin, end = follower.pose(start), follower.pose(follower.near(start, near))
    segment = arc(begin, end, bulge_m)
    if arc_flaw(begin.translation, segment) is not None:
        return
    plan = follower.plan(follower.problem(start, segment))
    if isinstance(plan, PlanningFailure) or len(plan.trajectory.time_s) == 1:
        return
    assert_keeps_rates(plan.trajectory, rate_limits)
    places_m = tips_m(follower, plan)
    a, b = begin.translation - end.translation, np.array(segment.via_m) - end.translation
    normal = np.cross(a, b)
    center_m = end.translation + np.cross(a @ a * b - b @ b * a, normal) / (2.0 * normal @ normal)
    radius_m = np.linalg.norm(begin.translation - center_m)
    assert np.abs((places_m - center_m) @ normal).max() / np.linalg.norm(normal) <= BOUND_M
    assert np.abs(np.linalg.norm(places_m - center_m, axis=1) - radius_m).max() <= BOUND_M


def test_corners_of_waypoints_are_passed_without_a_stop(follower):
    corners = [(0.0, 0.03, 0.0), (0.0, 0.03, -0.03), (0.0, 0.0, -0.03)]
    plan = follower.plan(follower.problem(START, *(shifted(follower, *corner) for corner in corners)))
    assert plan.fraction == 1.0
    assert np.abs(plan.trajectory.velocities_rad_s).max(axis=1)[3:-3].min() > 0.02
    for corner in corners:
        away_m = np.linalg.norm(tips_m(follower, plan) - follower.pose(START).translation - corner, axis=1)
        assert away_m.min() < 1e-3


def test_paths_of_whole_steps_and_of_hardly_any_length_are_planned(follower):
    # Rounding leaves no last piece that is too short to be timed.
    for z_m in (0.017, 0.037, 0.042):
        plan = planned(follower, 0.0, 0.0, z_m)
        assert plan.fraction == 1.0
        assert plan.trajectory.duration_s < 1.0
    for y_m in (0.0, 1e-6, 1e-4):
        plan = planned(follower, 0.0, y_m, 0.0)
        assert_well_formed(plan.trajectory)
        assert plan.fraction == 1.0
        assert plan.trajectory.duration_s < 0.2


@pytest.mark.parametrize("tip_speed_m_s", [0.01, 0.05, 0.2])
def test_the_tip_moves_as_fast_as_it_may_and_no_faster_and_a_scaled_motion_slower(follower, tip_speed_m_s):
    plan = planned(follower, 0.0, 0.06, 0.02, tip_speed_m_s=tip_speed_m_s)
    positions, velocities, _ = fine_samples(plan.trajectory)
    tracker = follower.tracker(START)
    speeds = [tracker.speed_m(point, velocity) for point, velocity in zip(positions, velocities, strict=True)]
    assert max(speeds) <= tip_speed_m_s * 1.001
    assert max(speeds) >= 0.9 * tip_speed_m_s or tip_speed_m_s > 0.1
    scaled = ({"velocity_scaling": share, "acceleration_scaling": share} for share in (1.0, 0.1))
    fast, slow = (planned(follower, 0.0, 0.08, 0.0, **each) for each in scaled)
    assert slow.trajectory.duration_s > 3.0 * fast.trajectory.duration_s


def test_the_nearest_orientation_is_taken_unless_it_must_be_kept(follower):
    loose = planned(follower, 0.0, 0.1, 0.0)
    strict = planned(follower, 0.0, 0.1, 0.0, keep_orientation=True, orientation_tolerance_rad=0.1)
    assert loose.fraction == 1.0
    assert loose.deviation.orientation_rad > 0.1
    assert 0.0 < strict.fraction < 1.0
    assert strict.deviation.orientation_rad <= 0.101
    assert (strict.stopped_by.details["reason"], strict.stopped_by.code) == ("orientation", Code.NO_IK_SOLUTION)
    # Five joints can keep an orientation within the plane of the arm.
    kept = planned(follower, 0.0, 0.0, -0.05, keep_orientation=True)
    assert kept.fraction == 1.0
    assert kept.deviation.orientation_rad < 0.02


def test_a_path_into_an_obstacle_ends_before_a_contact_that_counts_and_names_the_pair(follower, put):
    x, y, _ = follower.pose(START).translation.tolist()
    problem = follower.problem(START, shifted(follower, 0.0, 0.12, 0.0))
    # The second wall to the left of the tip stands within the last step of the path.
    for beside_m, least, most in ((0.11, 0.1, 0.9), (0.1288, 0.9, 0.99)):
        put(follower.collision, thing(Box((0.4, 0.01, 0.6)), x, y + beside_m, 0.3, name="wall"))
        plan = follower.plan(problem)
        assert least <= plan.fraction <= most
        stopped_by = plan.stopped_by
        assert (stopped_by.code, stopped_by.details["reason"]) == (Code.INVALID_MOTION_PLAN, "collision")
        assert "wall" in stopped_by.details["pairs"][0].values()
        assert "wall" in stopped_by.message
        assert_touches_nothing(plan.trajectory, follower.collision, problem.start_rad)
    plan = planned(follower, 0.0, 0.12, 0.0, avoid_collisions=False)
    assert (plan.fraction, plan.stopped_by) == (1.0, None)


def test_a_path_ends_out_of_reach_before_a_jump_or_where_the_constraints_no_longer_hold_and_says_so(follower):
    plan = planned(follower, 0.5, 0.0, 0.0)
    assert 0.0 < plan.fraction < 1.0
    assert (plan.stopped_by.code, plan.stopped_by.details["reason"]) == (Code.NO_IK_SOLUTION, "reach")
    assert plan.stopped_by.details["distance_m"] > 0.1
    plan = planned(follower, 0.0, 0.05, 0.0, max_joint_step_rad=1e-4)
    assert plan.fraction < 0.01
    assert plan.stopped_by.code == Code.PLANNING_FAILED
    assert plan.stopped_by.details["joint"] in follower.robot.groups["arm"].joints
    constraints = Constraints(joints=(JointConstraint("shoulder_pan", 0.0, 0.1, 0.1),))
    plan = planned(follower, 0.0, 0.1, 0.0, path_constraints=constraints)
    assert 0.0 < plan.fraction < 1.0
    assert plan.stopped_by.details["reason"] == "constraint"
    assert "shoulder_pan" in plan.stopped_by.message
    assert np.abs(plan.trajectory.positions_rad[:, 0]).max() <= 0.1 + 1e-6


def test_a_start_that_cannot_be_followed_from_is_refused(follower):
    upside_down = as_pose(pin.SE3(follower.pose(START).rotation @ np.diag([1.0, -1.0, -1.0]), np.zeros(3)))
    constraints = Constraints(orientations=(OrientationConstraint(TIP, upside_down.orientation, (0.1, 0.1, 0.1)),))
    path = shifted(follower, 0.0, 0.1, 0.0)
    violating = follower.plan(follower.problem(START, path, path_constraints=constraints))
    assert violating.code == Code.START_STATE_VIOLATES_PATH_CONSTRAINTS
    assert follower.plan(follower.problem(FOLDED_INTO_ITSELF, path)).code == Code.START_STATE_IN_COLLISION
    assert follower.plan(follower.problem(START, path), should_stop=lambda: True).code == Code.PREEMPTED


def test_points_are_added_until_the_curve_is_near_the_path_within_the_limits(follower):
    tracker, placement = follower.tracker(START), follower.pose(START)
    path = TipPath(placement, [line(moved(placement, 0.0, 0.08, 0.0))])
    end = tracker.follow(START, path.at(0.08), 0.0)
    # Far too few points for a line of 8 cm.
    few = FollowedPath(np.array([0.0, 0.08]), np.array([START, end]), None)
    followed, curve, _ = tip_curve(few, path, tracker)
    assert len(followed.points) > 3
    along_m = np.linspace(0.0, 0.08, 300)
    off_m = [apart_m(path.at(s), tracker.pose(p)) for s, p in zip(along_m, curve(along_m), strict=True)]
    assert max(off_m) <= 1.2 * CHORD_M
    # A joint may stop at its limit.
    path = TipPath(placement, [line(moved(placement, 0.0, 0.0, 0.04))])
    along_m = np.linspace(0.0, 0.04, 9)
    points = np.array([tracker.follow(START, path.at(s), 0.0) for s in along_m])
    shift = follower.upper_rad[4] - 1e-3 - points[:, 4].max()
    points[:4, 4] += np.linspace(-0.2, 0.0, 4) + shift
    points[4:, 4] = follower.upper_rad[4] - 1e-3
    _, curve, _ = tip_curve(FollowedPath(along_m, points, None), path, tracker)
    assert not tracker.outside(curve(np.linspace(0.0, 0.04, 1000))).any()


@given(share=shares, step_m=st.tuples(*[st.floats(-0.1, 0.1)] * 3))
@examples(60)
def test_no_joint_goes_beyond_its_limits(follower, share, step_m):
    start = follower.point(1.1 * share)
    tracker = follower.tracker(start)
    assert not tracker.outside(tracker.follow(start, moved(tracker.pose(start), *step_m), 1.0)).any()


def test_turning_for_the_orientation_alone_is_limited_and_the_speed_of_the_tip_that_of_its_positions(follower):
    start, tangent, step = np.array([0.2, -0.4, 0.6, 0.3, 0.1]), np.array([1.0, 0.5, -0.5, 0.2, 0.3]), 1e-6
    tracker, placement = follower.tracker(start), follower.pose(start)
    target = pin.SE3(placement.rotation @ pin.exp3(np.array([0.0, 0.0, 1.0])), placement.translation)
    assert np.abs(tracker.follow(start, target, 0.05) - start).max() <= 0.06
    assert np.abs(tracker.follow(start, target, 2.0) - start).max() > 0.5
    moved_m = apart_m(tracker.pose(start - step * tangent), tracker.pose(start + step * tangent))
    assert tracker.speed_m(start, tangent) == pytest.approx(0.5 * moved_m / step, rel=1e-5)
