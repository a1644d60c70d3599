from __future__ import annotations

import math

import numpy as np
import pytest

from planners.goals import JointGoal, PoseGoal, PositionGoal
from planners.problem import Arc, Line, MoveItErrorCode, PlanningProblem
from planners.scene import Pose
from server.errors import RefusedError
from server.moveit.requests.motion_plan import CIRCULAR, STRAIGHT, tip_problem
from tests.helpers.moveit_requests import FRAMES, HOME, TIP, assert_refused, ball, constraints, context

END = (0.3, 0.0, 0.2)
TO_POINT = PlanningProblem("arm", HOME, PositionGoal(TIP, END, 0.005), velocity_scaling=0.5)
NO_ARC = constraints()


def path(planner=STRAIGHT, problem=TO_POINT, arc=NO_ARC, tip_speed=0.0):
    return tip_problem(planner, problem, arc, tip_speed, context())


def refusal(**fields):
    with pytest.raises(RefusedError) as raised:
        path(**fields)
    return raised.value.failure


def test_a_line_ends_at_the_goal_in_whatever_orientation() -> None:
    line = path()
    (segment,) = line.segments
    assert isinstance(segment, Line)
    assert segment.end.position_m == END
    assert not line.keep_orientation
    assert line.velocity_scaling == 0.5


def test_a_strict_pose_keeps_its_orientation_on_the_way() -> None:
    goal = PoseGoal(TIP, Pose(END), 0.005, (0.1, 0.1, 0.2), strict=True)
    line = path(problem=PlanningProblem("arm", HOME, goal))
    assert line.keep_orientation
    assert line.orientation_tolerance_rad == 0.2


def test_a_joint_goal_is_where_it_brings_the_tip() -> None:
    goal = JointGoal({"elbow_flex": 0.4})
    line = path(problem=PlanningProblem("arm", HOME, goal))
    assert line.segments[0].end == FRAMES.resolve(TIP, HOME | {"elbow_flex": 0.4})


@pytest.mark.parametrize(("asked", "kept"), [(0.0, None), (0.05, 0.05)])
def test_the_speed_of_the_tip_is_bounded_when_that_is_asked(asked, kept) -> None:
    assert path(tip_speed=asked).tip_speed_m_s == kept


def test_a_circle_leads_through_its_interim_point() -> None:
    arc = constraints(name="interim", position_constraints=[ball(0.35, 0.03, 0.22)])
    (segment,) = path(CIRCULAR, arc=arc).segments
    assert isinstance(segment, Arc)
    assert segment.via_m == (0.35, 0.03, 0.22)


def test_a_circle_about_a_center_is_the_shorter_way_around_it() -> None:
    start = np.array(FRAMES.resolve(TIP, HOME).position_m)
    center = 0.5 * (start + END) + (0.0, 0.0, -0.1)
    arc = constraints(name="center", position_constraints=[ball(*center.tolist())])
    (segment,) = path(CIRCULAR, arc=arc).segments
    via = np.array(segment.via_m)
    assert np.linalg.norm(via - center) == pytest.approx(np.linalg.norm(start - center))
    assert via[2] > max(start[2], END[2])


BAD_ARCS = {
    "unnamed": (constraints(position_constraints=[ball(0.3, 0.0, 0.2)]), "'interim'"),
    "pointless": (constraints(name="interim"), "one position constraint"),
    "poseless": (constraints(name="interim", position_constraints=[{}]), "primitive_poses is empty"),
}


@pytest.mark.parametrize(("arc", "words"), BAD_ARCS.values(), ids=BAD_ARCS.keys())
def test_a_circle_without_a_point_is_refused(arc, words) -> None:
    assert_refused(refusal(planner=CIRCULAR, arc=arc), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, words)


def test_a_half_circle_about_a_center_is_refused_as_ambiguous() -> None:
    middle = 0.5 * (np.array(FRAMES.resolve(TIP, HOME).position_m) + END)
    arc = constraints(name="center", position_constraints=[ball(*middle.tolist())])
    assert_refused(refusal(planner=CIRCULAR, arc=arc), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "opposite")


def test_a_goal_of_several_points_is_no_path() -> None:
    goal = PositionGoal(TIP, END, 0.005, (math.pi, 0.0, 0.0))
    refused = refusal(problem=PlanningProblem("arm", HOME, goal))
    assert_refused(refused, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "one pose of one link")
