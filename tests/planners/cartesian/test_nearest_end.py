"""What works in place of paths that cannot be followed to their end."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from planners.cartesian.tip_path import TipPath, apart_m, apart_rad, first_part
from planners.nearest_goal import end_as_goal
from planners.problem import (
    CartesianPlan,
    Line,
    MoveItErrorCode,
    NearestGoalAnswer,
    NearestGoalQuestion,
    PathGoal,
    Plan,
)
from planners.scene import Box
from tests.planners.following import arc, line
from tests.planners.scenes import thing

START = np.array([0.0, -0.3, 0.5, 1.0, 0.0])


def shifted(follower, *by_m, turned=(0.0, 0.0, 0.0)):
    pose = follower.pose(START)
    return pin.SE3(pose.rotation @ pin.exp3(np.array(turned)), pose.translation + np.array(by_m))


def to_the_left(follower, y_m=0.12, down_m=0.0, **asked):
    return follower.problem(START, line(shifted(follower, 0.0, y_m, -down_m)), **asked)


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
        x, y, _ = follower.pose(START).translation.tolist()
        put(planner, thing(Box((0.4, 0.01, 0.6)), x, y + y_m, 0.3))

    return put_wall


def lines_and_arcs(follower):
    left = shifted(follower, 0.0, 0.12, 0.0)
    return {
        "line": (line(left),),
        "arc": (arc(follower.pose(START), left, 0.02),),
        "two lines": (line(shifted(follower, 0.0, 0.03, -0.02)), line(left)),
    }


@pytest.mark.parametrize(("kind", "keep_orientation"), [("line", True), ("arc", False), ("two lines", True)])
def test_the_same_path_can_be_planned_to_the_end_that_is_found(follower, planner, put_wall, kind, keep_orientation):
    put_wall()
    segments = lines_and_arcs(follower)[kind]
    asked = {"keep_orientation": True, "orientation_tolerance_rad": 0.3} if keep_orientation else {}
    problem = follower.problem(START, *segments, **asked)
    goal, plan = found(planner, problem)
    assert isinstance(goal, PathGoal)
    assert 0.0 < goal.fraction <= plan.fraction < 1.0
    # No more than a few millimetres of what can be followed are given away.
    assert goal.fraction * goal.length_m > plan.fraction * goal.length_m - 0.006
    path = TipPath(follower.pose(START), segments)
    place = path.at(goal.fraction * path.length_m)
    np.testing.assert_allclose(goal.end.position_m, place.translation, atol=1e-4)
    part = first_part(follower.pose(START), segments, goal.fraction * path.length_m, 4)
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
    x, y, z = follower.pose(START).translation.tolist()
    put(planner, thing(Box((0.3, 0.01, 2.0 * z + 0.03)), x, y + 0.08, 0.0))
    problem = to_the_left(follower, 0.2)
    goal, plan = found(planner, problem)
    assert plan.fraction < 1.0
    assert goal.end_by_other_way
    assert isinstance(planner.answer(end_as_goal(problem, 5.0)), Plan)


def test_another_way_keeps_the_orientation_that_the_path_keeps_and_reaches_no_end_out_of_reach(follower, planner):
    # Five joints have no such orientation there.
    problem = follower.problem(START, line(shifted(follower, 0.0, 0.1, 0.0, turned=(1.0, 0.0, 0.0))))
    free, _ = found(planner, replace(problem, max_joint_step_rad=1e-4))
    kept, _ = found(planner, replace(problem, keep_orientation=True))
    assert free.end_by_other_way
    assert kept is None or not kept.end_by_other_way
    goal, plan = found(planner, follower.problem(START, line(shifted(follower, 0.5, 0.0, 0.0))))
    assert 0.0 < plan.fraction < 1.0
    assert goal.end is not None
    assert not goal.end_by_other_way


def test_a_path_that_does_not_begin_names_no_place(follower, planner):
    goal, plan = found(planner, to_the_left(follower, 0.05, max_joint_step_rad=1e-9))
    assert plan.fraction == 0.0
    assert ", to (" not in plan.stopped_by.message
    assert goal == PathGoal(None, 0.0, goal.length_m, end_by_other_way=True)


def test_without_time_once_cancelled_or_for_a_problem_that_is_refused_there_is_none(follower, planner, put_wall):
    put_wall()
    problem = to_the_left(follower)
    assert found(planner, problem, 1e-9)[0] is None
    assert planner.answer(NearestGoalQuestion(problem, 5.0), lambda: True) == NearestGoalAnswer(None)
    unknown, failure = found(planner, replace(problem, link="tail"))
    assert failure.code is MoveItErrorCode.INVALID_LINK_NAME
    assert unknown is None


@pytest.mark.parametrize("kind", ["line", "arc", "two lines"])
def test_the_first_part_of_a_path_is_where_the_path_is(follower, kind):
    start, segments = follower.pose(START), lines_and_arcs(follower)[kind]
    whole = TipPath(start, segments)
    for share in (0.1, 0.5, 0.77, 0.95):
        part = TipPath(start, first_part(start, segments, share * whole.length_m, 9))
        assert part.length_m == pytest.approx(share * whole.length_m, abs=1e-6)
        for along_m in np.linspace(0.0, part.length_m, 7):
            assert apart_m(part.at(along_m), whole.at(along_m)) < 1e-6
            assert apart_rad(part.at(along_m), whole.at(along_m)) < 1e-4
    assert first_part(start, segments, whole.length_m + 1.0, 9) == segments


def test_the_failure_of_a_path_has_the_place_that_its_motion_reaches(follower, planner, put_wall):
    put_wall()
    plan = planner.answer(to_the_left(follower))
    details = plan.stopped_by.details
    reached = follower.pose(plan.trajectory.positions_rad[-1])
    np.testing.assert_allclose(details["reached_m"], reached.translation, atol=2e-4)
    assert details["reached_fraction"] == plan.fraction
    assert ", to (" in plan.stopped_by.message
    assert len(details["reached_orientation"]) == 4
