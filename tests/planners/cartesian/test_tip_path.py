"""Paths of the tip, and what works in place of those that cannot be followed to their end."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.cartesian.tip_path import TipPath, apart_m, apart_rad, arc_flaw, check_path, check_shape, first_part
from planners.goals import Constraints, JointConstraint
from planners.nearest_goal import end_as_goal
from planners.problem import (
    Arc,
    CartesianPlan,
    CartesianProblem,
    Line,
    MoveItErrorCode,
    NearestGoalAnswer,
    NearestGoalQuestion,
    PathGoal,
    Plan,
)
from planners.problem import MoveItErrorCode as Code
from planners.scene import Box, Pose
from tests.helpers.resources import examples
from tests.planners.following import arc, line
from tests.planners.invariants import refusal
from tests.planners.scenes import thing

START = pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.1]))
QUARTER_ABOUT_Z = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))

coordinates = st.floats(-0.3, 0.3).map(lambda value: round(value, 3))
points = st.tuples(*[coordinates] * 3)


def tame(arc):
    return arc_flaw(START.translation, arc) is None


def path_to(*places_m):
    return TipPath(START, [Line(Pose(place_m)) for place_m in places_m])


@given(st.builds(lambda via, end: Arc(via, Pose(end)), points, points).filter(tame))
@examples(30)
def test_an_arc_goes_evenly_through_its_points_and_has_its_length(arc):
    path = TipPath(START, [arc])
    way = np.array([path.at(along_m).translation for along_m in np.linspace(0.0, path.length_m, 500)])
    np.testing.assert_allclose(way[0], START.translation, atol=1e-9)
    np.testing.assert_allclose(way[-1], arc.end.position_m, atol=1e-6)
    steps_m = np.linalg.norm(np.diff(way, axis=0), axis=1)
    assert np.linalg.norm(way - np.array(arc.via_m), axis=1).min() <= steps_m.max() + 1e-6
    np.testing.assert_allclose(steps_m, steps_m.mean(), rtol=1e-3)
    assert steps_m.sum() == pytest.approx(path.length_m, rel=1e-3)


def test_repeated_points_add_nothing_corners_are_where_the_direction_changes_and_a_turn_has_a_length():
    here_m, there_m = (0.2, 0.0, 0.1), (0.25, 0.0, 0.1)
    path = path_to(here_m, there_m, there_m)
    assert path.length_m == pytest.approx(0.05)
    assert path.corners_m == [path.length_m]
    assert path_to(here_m).length_m == 0.0
    for second_m, corners in (((0.3, 0.0, 0.1), 1), ((0.25, 0.05, 0.1), 2), (here_m, 2)):
        path = path_to(there_m, second_m)
        assert len(path.corners_m) == corners
        assert path.corners_m[0] == pytest.approx(0.05 if corners == 2 else 0.1)
    path = TipPath(START, [Line(Pose(here_m, QUARTER_ABOUT_Z))])
    assert path.length_m == pytest.approx(0.1 * np.pi / 2.0)
    half = path.at(0.5 * path.length_m)
    assert apart_rad(START, half) == pytest.approx(np.pi / 4.0)
    np.testing.assert_allclose(half.translation, START.translation)
    # Three points may make no arc.
    for via_m, end_m, flaw in (
        (here_m, (0.3, 0.0, 0.1), "the same"),
        (there_m, here_m, "the same"),
        (there_m, (0.3, 0.0, 0.1), "on a line"),
    ):
        assert flaw in arc_flaw(START.translation, Arc(via_m, Pose(end_m)))


PROBLEM = CartesianProblem("arm", {}, "gripper_frame_link", (Line(Pose((0.2, 0.0, 0.1))),))
NAN = float("nan")
INVALID = Code.INVALID_GOAL_CONSTRAINTS


def assert_refused(failure, code, *words):
    assert failure.code == code, words
    assert all(word in failure.message for word in words), failure


def test_each_bad_name_number_or_segment_is_refused_by_name_and_too_many_points_with_the_limit(robot):
    knee = Constraints(joints=(JointConstraint("knee", 0.0, 0.1, 0.1),))
    for asked, code, said in (
        ({"group": "leg"}, Code.INVALID_GROUP_NAME, "leg"),
        ({"link": "toe"}, Code.INVALID_LINK_NAME, "toe"),
        ({"link": ""}, Code.INVALID_LINK_NAME, "''"),
        ({"segments": ()}, INVALID, "no segment"),
        ({"velocity_scaling": 0.0}, INVALID, "velocity scaling"),
        ({"acceleration_scaling": 1.5}, INVALID, "acceleration scaling"),
        ({"max_step_m": 0.0}, INVALID, "greatest step"),
        ({"max_joint_step_rad": -1.0}, INVALID, "joint step"),
        ({"tip_speed_m_s": NAN}, INVALID, "tip speed"),
        ({"allowed_time_s": float("inf")}, INVALID, "planning time"),
        ({"keep_orientation": True, "orientation_tolerance_rad": -0.1}, INVALID, "orientation tolerance"),
        ({"path_constraints": knee}, INVALID, "knee"),
    ):
        assert_refused(refusal(check_path, robot, replace(PROBLEM, **asked)), code, said)
    for segment, said in (
        (Line(Pose((NAN, 0.0, 0.0))), "not finite"),
        (Line(Pose((0.2, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))), "length 0"),
        (Line(Pose((0.2, 0.0, 0.0), (0.0, 0.0, 0.0, NAN))), "length nan"),
        (Arc((NAN, 0.0, 0.0), Pose((0.2, 0.0, 0.0))), "not finite"),
    ):
        bad = replace(PROBLEM, segments=(*PROBLEM.segments, segment))
        assert_refused(refusal(check_path, robot, bad), INVALID, "segment 1", said)
    too_fine = replace(PROBLEM, max_step_m=1e-6)
    assert_refused(refusal(check_shape, np.array([0.1, 0.0, 0.1]), too_fine), INVALID, "10000")


START_RAD = np.array([0.0, -0.3, 0.5, 1.0, 0.0])


def shifted(follower, *by_m, turned=(0.0, 0.0, 0.0)):
    pose = follower.pose(START_RAD)
    return pin.SE3(pose.rotation @ pin.exp3(np.array(turned)), pose.translation + np.array(by_m))


def to_the_left(follower, y_m=0.12, down_m=0.0, **asked):
    return follower.problem(START_RAD, line(shifted(follower, 0.0, y_m, -down_m)), **asked)


def found(planner, problem, allowed_time_s=5.0):
    """Return what works, and the plan of the part that can be followed."""
    plan = planner.answer(problem)
    answer = planner.answer(NearestGoalQuestion(problem, allowed_time_s))
    assert isinstance(answer, NearestGoalAnswer)
    return answer.goal, plan


@pytest.fixture
def put_wall(follower, planner, put):
    """Put a wall to the left of the tip."""

    def put_wall(y_m=0.11):
        x, y, _ = follower.pose(START_RAD).translation.tolist()
        put(planner, thing(Box((0.4, 0.01, 0.6)), x, y + y_m, 0.3))

    return put_wall


def lines_and_arcs(follower):
    left = shifted(follower, 0.0, 0.12, 0.0)
    return {
        "line": (line(left),),
        "arc": (arc(follower.pose(START_RAD), left, 0.02),),
        "two lines": (line(shifted(follower, 0.0, 0.03, -0.02)), line(left)),
    }


@pytest.mark.parametrize(("kind", "keep_orientation"), [("line", True), ("arc", False), ("two lines", True)])
def test_the_same_path_can_be_planned_to_the_end_that_is_found(follower, planner, put_wall, kind, keep_orientation):
    put_wall()
    segments = lines_and_arcs(follower)[kind]
    asked = {"keep_orientation": True, "orientation_tolerance_rad": 0.3} if keep_orientation else {}
    problem = follower.problem(START_RAD, *segments, **asked)
    goal, plan = found(planner, problem)
    assert isinstance(goal, PathGoal)
    assert 0.0 < goal.fraction <= plan.fraction < 1.0
    # No more than a few millimetres of what can be followed are given away.
    assert goal.fraction * goal.length_m > plan.fraction * goal.length_m - 0.006
    path = TipPath(follower.pose(START_RAD), segments)
    place = path.at(goal.fraction * path.length_m)
    np.testing.assert_allclose(goal.end.position_m, place.translation, atol=1e-4)
    part = first_part(follower.pose(START_RAD), segments, goal.fraction * path.length_m, 4)
    assert part[-1].end == goal.end
    again = planner.answer(replace(problem, segments=part))
    assert isinstance(again, CartesianPlan)
    assert again.stopped_by is None


def test_the_end_that_is_found_is_planned_again_whole_where_its_rounding_would_touch(follower, planner, put_wall):
    # Before the second wall the first end that is tried is not followed whole.
    for y_m, down_m in ((0.07897435897435898, 0.0), (0.12, 0.03)):
        put_wall(y_m)
        problem = to_the_left(follower, down_m=down_m)
        goal, _ = found(planner, problem)
        assert planner.answer(replace(problem, segments=(Line(goal.end),))).stopped_by is None


def test_the_end_of_a_path_behind_an_obstacle_is_reached_by_another_way(follower, planner, put):
    x, y, z = follower.pose(START_RAD).translation.tolist()
    put(planner, thing(Box((0.3, 0.01, 2.0 * z + 0.03)), x, y + 0.08, 0.0))
    problem = to_the_left(follower, 0.2)
    goal, plan = found(planner, problem)
    assert plan.fraction < 1.0
    assert goal.end_by_other_way
    assert isinstance(planner.answer(end_as_goal(problem, 5.0)), Plan)


def test_another_way_keeps_the_orientation_that_the_path_keeps_and_reaches_no_end_out_of_reach(follower, planner):
    # Five joints have no such orientation there.
    problem = follower.problem(START_RAD, line(shifted(follower, 0.0, 0.1, 0.0, turned=(1.0, 0.0, 0.0))))
    free, _ = found(planner, replace(problem, max_joint_step_rad=1e-4))
    kept, _ = found(planner, replace(problem, keep_orientation=True))
    assert free.end_by_other_way
    assert kept is None or not kept.end_by_other_way
    goal, plan = found(planner, follower.problem(START_RAD, line(shifted(follower, 0.5, 0.0, 0.0))))
    assert 0.0 < plan.fraction < 1.0
    assert goal.end is not None
    assert not goal.end_by_other_way


def test_the_failure_of_a_path_has_the_place_that_its_motion_reaches(follower, planner, put_wall):
    put_wall()
    problem = to_the_left(follower)
    plan = planner.answer(problem)
    details = plan.stopped_by.details
    reached = follower.pose(plan.trajectory.positions_rad[-1])
    np.testing.assert_allclose(details["reached_m"], reached.translation, atol=2e-4)
    assert details["reached_fraction"] == plan.fraction
    assert ", to (" in plan.stopped_by.message
    assert len(details["reached_orientation"]) == 4
    goal, plan = found(planner, to_the_left(follower, 0.05, max_joint_step_rad=1e-9))
    assert plan.fraction == 0.0
    assert ", to (" not in plan.stopped_by.message
    assert goal == PathGoal(None, 0.0, goal.length_m, end_by_other_way=True)
    # Without time, once cancelled, or for a problem that is refused there is no other goal.
    assert found(planner, problem, 1e-9)[0] is None
    assert planner.answer(NearestGoalQuestion(problem, 5.0), lambda: True) == NearestGoalAnswer(None)
    unknown, failure = found(planner, replace(problem, link="tail"))
    assert failure.code is MoveItErrorCode.INVALID_LINK_NAME
    assert unknown is None


@pytest.mark.parametrize("kind", ["line", "arc", "two lines"])
def test_the_first_part_of_a_path_is_where_the_path_is(follower, kind):
    start, segments = follower.pose(START_RAD), lines_and_arcs(follower)[kind]
    whole = TipPath(start, segments)
    for share in (0.1, 0.5, 0.77, 0.95):
        part = TipPath(start, first_part(start, segments, share * whole.length_m, 9))
        assert part.length_m == pytest.approx(share * whole.length_m, abs=1e-6)
        for along_m in np.linspace(0.0, part.length_m, 7):
            assert apart_m(part.at(along_m), whole.at(along_m)) < 1e-6
            assert apart_rad(part.at(along_m), whole.at(along_m)) < 1e-4
    assert first_part(start, segments, whole.length_m + 1.0, 9) == segments
