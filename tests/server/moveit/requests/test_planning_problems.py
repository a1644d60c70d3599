"""moveit_msgs/MotionPlanRequest and MotionSequenceRequest."""

import math

import numpy as np
import pytest

from planners.goals import JointGoal, PoseGoal, PositionGoal
from planners.problem import Line, MoveItErrorCode, PlanningProblem
from planners.scene import Pose
from server.execution.monitors import CurrentState
from server.moveit.parameters import (
    MAX_ALLOWED_PLANNING_TIME_S,
    MAX_PLANNING_ATTEMPTS,
    MoveItParameters,
    PlannerParameters,
)
from server.moveit.requests import planning_problems
from tests.helpers.fake_arm import HOME, FakeArm
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
INVALID, BROKEN = MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, MoveItErrorCode.INVALID_MOTION_PLAN


def asked(parameters=PARAMETERS, **fields):
    request = message("MotionPlanRequest", **{"goal_constraints": [GOAL], **fields})
    builder = planning_problems.ProblemBuilder(
        ROBOT, FRAMES, PlannerParameters(parameters), CurrentState(FakeArm().as_arm)
    )
    return outcome(builder.motion_plan, request, HOME)


def test_a_request_with_only_a_goal_is_planned_by_the_parameters() -> None:
    assert asked().problem == PlanningProblem(
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
    said = asked(
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
    problem = asked(parameters, allowed_planning_time=2.5).problem
    assert (problem.optimization_time_s, problem.allowed_time_s) == (time_s, 2.5)


CORNER = {"max_corner": {"y": math.nan}}
NO_VALUES = [
    ({"allowed_planning_time": -1.0}, "allowed_planning_time must be 0 s or more"),
    ({"allowed_planning_time": math.nan}, "allowed_planning_time must be 0 s or more"),
    ({"num_planning_attempts": -1}, "num_planning_attempts must be 0 or more"),
    ({"workspace_parameters": CORNER}, "workspace_parameters.max_corner.y must be a finite number, not nan"),
    ({"max_cartesian_speed": math.nan}, "max_cartesian_speed must be a number, not nan"),
]


@pytest.mark.parametrize(("fields", "words"), NO_VALUES)
def test_values_that_mean_nothing_are_refused_by_name(fields, words: str) -> None:
    assert_refused(asked(**fields), INVALID, words)


@pytest.mark.parametrize("field", ["max_velocity_scaling_factor", "max_acceleration_scaling_factor"])
def test_a_senseless_scaling_is_refused_by_field_and_value(field: str) -> None:
    for value in (-0.1, math.nan, 5e-324):
        assert_refused(asked(**{field: value}), INVALID, field, f"not {value:g}")


def test_speed_time_and_attempts_are_bounded_with_a_warning() -> None:
    read = asked(max_velocity_scaling_factor=1.5, allowed_planning_time=1e6, num_planning_attempts=10_000)
    assert read.problem.velocity_scaling == 1.0
    assert read.problem.allowed_time_s == MAX_ALLOWED_PLANNING_TIME_S
    assert read.problem.attempts == MAX_PLANNING_ATTEMPTS
    assert len(read.warnings) == 3
    assert any("max_velocity_scaling_factor 1.5" in warning for warning in read.warnings)


IGNORED = {"trajectory_constraints": {"constraints": [{}]}, "reference_trajectories": [{}], "max_cartesian_speed": 0.1}


@pytest.mark.parametrize("field", IGNORED)
def test_ignored_fields_have_a_warning(field: str) -> None:
    assert field in asked(**{field: IGNORED[field]}).warnings[0]


def test_an_unknown_planner_of_pilz_fails_and_its_smoothness_is_understood() -> None:
    answer = asked(pipeline_id=planning_problems.PILZ, planner_id="POLYLINE", smoothness_level=0.5)
    assert_refused(answer, MoveItErrorCode.PLANNING_FAILED, "'POLYLINE'", "PTP, LIN, CIRC")


END = (0.3, 0.0, 0.2)
TO_POINT = PlanningProblem("arm", HOME, PositionGoal(TIP, END, 0.005), velocity_scaling=0.5)
NO_ARC = constraints()


def path(planner=planning_problems.STRAIGHT, problem=TO_POINT, arc=NO_ARC):
    return planning_problems.tip_problem(planner, problem, arc, None, context())


def test_a_line_ends_at_the_goal_in_whatever_orientation_and_several_points_are_no_path() -> None:
    line = path()
    assert [segment.end.position_m for segment in line.segments] == [END]
    assert isinstance(line.segments[0], Line)
    assert (line.keep_orientation, line.velocity_scaling) == (False, 0.5)
    # A joint goal is where it brings the tip.
    bent = path(problem=PlanningProblem("arm", HOME, JointGoal({"elbow_flex": 0.4})))
    assert bent.segments[0].end == FRAMES.resolve(TIP, HOME | {"elbow_flex": 0.4})
    goal = PositionGoal(TIP, END, 0.005, (math.pi, 0.0, 0.0))
    refused = rejection(path, problem=PlanningProblem("arm", HOME, goal))
    assert_refused(refused, INVALID, "one pose of one link")


def test_a_strict_pose_keeps_its_orientation_on_the_way() -> None:
    goal = PoseGoal(TIP, Pose(END), 0.005, (0.1, 0.1, 0.2), strict=True)
    line = path(problem=PlanningProblem("arm", HOME, goal))
    assert (line.keep_orientation, line.orientation_tolerance_rad) == (True, 0.2)


@pytest.mark.parametrize(("speed", "kept"), [(0.0, None), (0.05, 0.05)])
def test_a_line_keeps_the_speed_of_the_tip_that_its_request_names(speed: float, kept: float | None) -> None:
    line = asked(pipeline_id=planning_problems.PILZ, planner_id="LIN", max_cartesian_speed=speed)
    assert line.problem.tip_speed_m_s == kept


def test_a_circle_leads_through_its_interim_point_or_the_shorter_way_around_its_center() -> None:
    arc = constraints(name="interim", position_constraints=[ball(0.35, 0.03, 0.22)])
    assert [segment.via_m for segment in path(planning_problems.CIRCULAR, arc=arc).segments] == [(0.35, 0.03, 0.22)]
    start = np.array(FRAMES.resolve(TIP, HOME).position_m)
    center = 0.5 * (start + END) + (0.0, 0.0, -0.1)
    arc = constraints(name="center", position_constraints=[ball(*center.tolist())])
    (segment,) = path(planning_problems.CIRCULAR, arc=arc).segments
    via = np.array(segment.via_m)
    assert np.linalg.norm(via - center) == pytest.approx(np.linalg.norm(start - center))
    assert via[2] > max(start[2], END[2])


MIDDLE = 0.5 * (np.array(FRAMES.resolve(TIP, HOME).position_m) + END)
BAD_ARCS = [
    (constraints(position_constraints=[ball(0.3, 0.0, 0.2)]), "'interim'"),
    (constraints(name="interim"), "one position constraint"),
    (constraints(name="interim", position_constraints=[{}]), "primitive_poses is empty"),
    # Half a circle about its center may go either way.
    (constraints(name="center", position_constraints=[ball(*MIDDLE.tolist())]), "opposite"),
]


@pytest.mark.parametrize(("arc", "words"), BAD_ARCS)
def test_a_circle_without_a_point_is_refused(arc, words) -> None:
    assert_refused(rejection(path, planner=planning_problems.CIRCULAR, arc=arc), INVALID, words)


def read(*items):
    return outcome(planning_problems.sequence_requests, message("MotionSequenceRequest", items=list(items)))


def test_a_start_in_the_middle_a_blend_radius_and_a_wrong_number_of_items_are_refused_by_their_place() -> None:
    start = {"start_state": {"joint_state": {"name": ["elbow_flex"], "position": [0.1]}}}
    assert_refused(read({}, {"req": start}), BROKEN, "items[1].req.start_state")
    for radius in (0.01, -0.01):
        failure = assert_refused(
            read({"blend_radius": radius}, {}), BROKEN, "items[0].blend_radius", f"{radius:g}", "rest"
        )
        assert failure.details["item"] == 0
    for count in (0, planning_problems.MAX_ITEMS + 1):
        assert_refused(read(*[{}] * count), BROKEN, str(count), str(planning_problems.MAX_ITEMS))
