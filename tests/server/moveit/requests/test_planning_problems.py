"""moveit_msgs/MotionPlanRequest and MotionSequenceRequest."""

import math
from typing import Any

import numpy as np
import pytest

from planners.goals import JointGoal, PoseGoal, PositionGoal
from planners.problem import Arc, Line, MoveItErrorCode, PlanningProblem
from planners.scene import Pose
from server.moveit.parameters import (
    MAX_ALLOWED_PLANNING_TIME_S,
    MAX_PLANNING_ATTEMPTS,
    MoveItParameters,
    PlannerParameters,
)
from server.moveit.requests.planning_problems import (
    CIRCULAR,
    MAX_ITEMS,
    PILZ,
    STRAIGHT,
    BuiltProblem,
    ProblemBuilder,
    sequence_requests,
    tip_problem,
)
from tests.helpers.fake_arm import HOME
from tests.helpers.moveit import (
    FRAMES,
    ROBOT,
    TIP,
    assert_refused,
    ball,
    constraints,
    context,
    joint,
    message,
    outcome,
    rejection,
)

GOAL = {"joint_constraints": [joint("elbow_flex", 0.5)]}
PARAMETERS = MoveItParameters()


def asked(parameters=PARAMETERS, **fields):
    request = message("MotionPlanRequest", **{"goal_constraints": [GOAL], **fields})
    return outcome(ProblemBuilder(ROBOT, FRAMES, PlannerParameters(parameters)).motion_plan, request, HOME)


def built(parameters=PARAMETERS, **fields) -> BuiltProblem:
    read = asked(parameters, **fields)
    assert isinstance(read, BuiltProblem), read
    return read


def test_a_request_with_only_a_goal_is_planned_by_the_parameters() -> None:
    assert built().problem == PlanningProblem(
        "arm",
        HOME,
        JointGoal({"elbow_flex": 0.5}, PARAMETERS.joint_tolerance),
        velocity_scaling=PARAMETERS.max_velocity_scaling,
        acceleration_scaling=PARAMETERS.max_acceleration_scaling,
        allowed_time_s=PARAMETERS.allowed_planning_time,
        attempts=PARAMETERS.num_planning_attempts,
        optimization_time_s=PARAMETERS.optimization_time,
    )


def test_fields_of_a_request_override_the_parameters() -> None:
    said: Any = built(
        group_name="arm",
        num_planning_attempts=7,
        allowed_planning_time=2.5,
        max_velocity_scaling_factor=0.2,
        max_acceleration_scaling_factor=0.1,
        planner_id="RRT",
    ).problem
    assert (said.attempts, said.allowed_time_s, said.planner_id) == (7, 2.5, "RRT")
    assert (said.velocity_scaling, said.acceleration_scaling) == (0.2, 0.1)


@pytest.mark.parametrize(("optimization", "time_s"), [("first", 0.0), ("short", 0.5), ("best", 2.5)])
def test_the_chosen_optimization_has_its_time_and_the_best_motion_all_that_is_allowed(optimization, time_s) -> None:
    parameters = PARAMETERS.changed({"optimization": optimization, "optimization_time": 0.5})
    problem: Any = built(parameters, allowed_planning_time=2.5).problem
    assert (problem.optimization_time_s, problem.allowed_time_s) == (time_s, 2.5)


@pytest.mark.parametrize("field", ["max_velocity_scaling_factor", "max_acceleration_scaling_factor"])
@pytest.mark.parametrize("value", [-0.1, math.nan])
def test_a_senseless_scaling_is_refused(field: str, value: float) -> None:
    assert_refused(asked(**{field: value}), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, field, f"{value:g}")


def test_a_scaling_above_one_is_full_speed_with_a_warning() -> None:
    read = built(max_velocity_scaling_factor=1.5)
    assert read.problem.velocity_scaling == 1.0
    assert "max_velocity_scaling_factor 1.5" in read.warnings[0]


NO_VALUES = {
    "time": ({"allowed_planning_time": -1.0}, "allowed_planning_time must be 0 s or more"),
    "no time": ({"allowed_planning_time": math.nan}, "allowed_planning_time must be 0 s or more"),
    "attempts": ({"num_planning_attempts": -1}, "num_planning_attempts must be 0 or more"),
    "workspace": (
        {"workspace_parameters": {"max_corner": {"y": math.nan}}},
        "workspace_parameters.max_corner.y must be a finite number, not nan",
    ),
    "speed": ({"max_cartesian_speed": math.nan}, "max_cartesian_speed must be a number, not nan"),
}


@pytest.mark.parametrize(("fields", "words"), NO_VALUES.values(), ids=NO_VALUES)
def test_values_that_mean_nothing_are_refused_by_name(fields, words: str) -> None:
    assert_refused(asked(**fields), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, words)


def test_time_and_attempts_are_bounded_with_a_warning() -> None:
    read: Any = built(allowed_planning_time=1e6, num_planning_attempts=10_000)
    assert read.problem.allowed_time_s == MAX_ALLOWED_PLANNING_TIME_S
    assert read.problem.attempts == MAX_PLANNING_ATTEMPTS
    assert len(read.warnings) == 2


IGNORED = {"trajectory_constraints": {"constraints": [{}]}, "reference_trajectories": [{}], "max_cartesian_speed": 0.1}


@pytest.mark.parametrize("field", IGNORED)
def test_ignored_fields_have_a_warning(field: str) -> None:
    assert field in built(**{field: IGNORED[field]}).warnings[0]


def test_an_unknown_planner_of_pilz_fails_and_its_smoothness_is_understood() -> None:
    answer = asked(pipeline_id=PILZ, planner_id="POLYLINE", smoothness_level=0.5)
    assert_refused(answer, MoveItErrorCode.PLANNING_FAILED, "'POLYLINE'", "PTP, LIN, CIRC")


END = (0.3, 0.0, 0.2)
TO_POINT = PlanningProblem("arm", HOME, PositionGoal(TIP, END, 0.005), velocity_scaling=0.5)
NO_ARC = constraints()


def path(planner=STRAIGHT, problem=TO_POINT, arc=NO_ARC, tip_speed=0.0):
    return tip_problem(planner, problem, arc, tip_speed, context())


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
def test_the_speed_of_the_tip_is_bounded_on_request(asked, kept) -> None:
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
    assert_refused(rejection(path, planner=CIRCULAR, arc=arc), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, words)


def test_a_half_circle_about_a_center_is_refused_as_ambiguous() -> None:
    middle = 0.5 * (np.array(FRAMES.resolve(TIP, HOME).position_m) + END)
    arc = constraints(name="center", position_constraints=[ball(*middle.tolist())])
    assert_refused(rejection(path, planner=CIRCULAR, arc=arc), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "opposite")


def test_a_goal_of_several_points_is_no_path() -> None:
    goal = PositionGoal(TIP, END, 0.005, (math.pi, 0.0, 0.0))
    refused = rejection(path, problem=PlanningProblem("arm", HOME, goal))
    assert_refused(refused, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "one pose of one link")


NAMED_START = {"start_state": {"joint_state": {"name": ["elbow_flex"], "position": [0.1]}}}


def read(*items):
    return outcome(sequence_requests, message("MotionSequenceRequest", items=list(items)))


def test_a_start_in_the_middle_is_refused_by_its_place() -> None:
    assert_refused(read({}, {"req": NAMED_START}), MoveItErrorCode.INVALID_MOTION_PLAN, "items[1].req.start_state")


@pytest.mark.parametrize("radius", [0.01, -0.01])
def test_a_blend_radius_is_refused_with_its_reason(radius: float) -> None:
    refusal = read({"blend_radius": radius}, {})
    failure = assert_refused(
        refusal, MoveItErrorCode.INVALID_MOTION_PLAN, "items[0].blend_radius", f"{radius:g}", "rest"
    )
    assert failure.details["item"] == 0


@pytest.mark.parametrize("count", [0, MAX_ITEMS + 1])
def test_no_items_and_too_many_are_refused_with_the_limit(count: int) -> None:
    assert_refused(read(*[{}] * count), MoveItErrorCode.INVALID_MOTION_PLAN, str(count), str(MAX_ITEMS))
