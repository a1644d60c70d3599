from __future__ import annotations

import math

import pytest

from planners.goals import JointGoal
from planners.problem import PLANNER_IDS, CartesianProblem, MoveItErrorCode, PlanningProblem
from server.moveit.parameters import MAX_ALLOWED_PLANNING_TIME_S, MAX_PLANNING_ATTEMPTS, MoveItParameters
from server.moveit.requests.motion_plan import OMPL, PILZ, PlanRequest, problem_of
from tests.helpers.moveit_requests import FRAMES, HOME, ROBOT, assert_refused, ball, joint, message

GOAL = {"joint_constraints": [joint("elbow_flex", 0.5)]}
PARAMETERS = MoveItParameters()


def asked(parameters=PARAMETERS, **fields):
    request = message("MotionPlanRequest", **{"goal_constraints": [GOAL], **fields})
    return problem_of(request, HOME, FRAMES, ROBOT, parameters)


def problem(**fields) -> PlanningProblem:
    read = asked(**fields)
    assert isinstance(read, PlanRequest)
    assert isinstance(read.problem, PlanningProblem)
    return read.problem


def test_a_request_that_says_nothing_but_its_goal_is_planned_by_the_parameters_at_full_speed() -> None:
    assert problem() == PlanningProblem(
        "arm",
        HOME,
        JointGoal({"elbow_flex": 0.5}, PARAMETERS.joint_tolerance),
        velocity_scaling=1.0,
        acceleration_scaling=1.0,
        allowed_time_s=PARAMETERS.allowed_planning_time,
        attempts=PARAMETERS.num_planning_attempts,
        optimization_time_s=PARAMETERS.optimization_time,
    )


def test_what_a_request_says_counts() -> None:
    said = problem(
        group_name="arm",
        num_planning_attempts=7,
        allowed_planning_time=2.5,
        max_velocity_scaling_factor=0.2,
        max_acceleration_scaling_factor=0.1,
        planner_id="RRT",
    )
    assert (said.attempts, said.allowed_time_s, said.planner_id) == (7, 2.5, "RRT")
    assert (said.velocity_scaling, said.acceleration_scaling) == (0.2, 0.1)


@pytest.mark.parametrize("name", ["manipulator", "/arm"])
def test_an_unknown_group_is_refused_with_those_that_exist(name: str) -> None:
    assert_refused(asked(group_name=name), MoveItErrorCode.INVALID_GROUP_NAME, repr(name), "arm, gripper")


@pytest.mark.parametrize("field", ["max_velocity_scaling_factor", "max_acceleration_scaling_factor"])
@pytest.mark.parametrize("value", [-0.1, math.nan])
def test_a_senseless_scaling_is_refused(field: str, value: float) -> None:
    assert_refused(asked(**{field: value}), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, field, f"{value:g}")


def test_a_scaling_above_one_is_full_speed_and_told() -> None:
    read = asked(max_velocity_scaling_factor=1.5)
    assert isinstance(read, PlanRequest)
    assert read.problem.velocity_scaling == 1.0
    assert "max_velocity_scaling_factor 1.5" in read.warnings[0]


@pytest.mark.parametrize(("field", "value"), [("allowed_planning_time", -1.0), ("num_planning_attempts", -1)])
def test_time_and_attempts_below_zero_are_the_defaults(field: str, value: float) -> None:
    assert problem(**{field: value}) == problem()


def test_time_and_attempts_are_bounded_and_that_is_told() -> None:
    read = asked(allowed_planning_time=1e6, num_planning_attempts=10_000)
    assert isinstance(read, PlanRequest)
    assert isinstance(read.problem, PlanningProblem)
    assert read.problem.allowed_time_s == MAX_ALLOWED_PLANNING_TIME_S
    assert read.problem.attempts == MAX_PLANNING_ATTEMPTS
    assert len(read.warnings) == 2


def test_a_planning_time_that_is_no_number_is_refused() -> None:
    refusal = asked(allowed_planning_time=math.nan)
    assert_refused(refusal, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "allowed_planning_time", "nan")


@pytest.mark.parametrize("pipeline", ["", OMPL])
def test_the_pipeline_of_these_planners_is_known(pipeline: str) -> None:
    assert problem(pipeline_id=pipeline) == problem()


def test_an_unknown_pipeline_is_refused_with_those_that_exist() -> None:
    assert_refused(asked(pipeline_id="chomp"), MoveItErrorCode.FAILURE, "'chomp'", OMPL, PILZ)


def test_an_unknown_planner_is_replaced_and_told() -> None:
    read = asked(planner_id="CHOMP", parameters=MoveItParameters(planner_id="RRT"))
    assert isinstance(read, PlanRequest)
    assert isinstance(read.problem, PlanningProblem)
    assert read.problem.planner_id == "RRT"
    assert "'CHOMP'" in read.warnings[0]


@pytest.mark.parametrize("spelled", ["RRTConnect", "RRTConnectkConfigDefault", "geometric::RRTConnect"])
def test_planners_are_known_in_moveits_spellings(spelled: str) -> None:
    assert problem(planner_id=spelled).planner_id == PLANNER_IDS[0]


def test_the_workspace_says_nothing() -> None:
    box = {"min_corner": {"x": math.nan, "y": 0.0, "z": 0.0}, "header": {"frame_id": "moon"}}
    assert asked(workspace_parameters=box) == asked()


IGNORED = {
    "trajectory_constraints": {"constraints": [{}]},
    "reference_trajectories": [{}],
    "max_cartesian_speed": 0.1,
}


@pytest.mark.parametrize("field", IGNORED)
def test_what_is_not_heeded_is_told(field: str) -> None:
    read = asked(**{field: IGNORED[field]})
    assert isinstance(read, PlanRequest)
    assert field in read.warnings[0]


def test_path_constraints_hold_on_the_way() -> None:
    held = problem(path_constraints={"joint_constraints": [joint("wrist_roll", 0.0, 0.1, 0.1)]})
    assert held.path_constraints is not None
    assert held.path_constraints.joints[0].joint == "wrist_roll"


def test_pilz_point_to_point_is_any_motion() -> None:
    assert problem(pipeline_id=PILZ, planner_id="PTP") == problem()


def test_pilz_line_is_a_path_of_the_tip() -> None:
    read = asked(pipeline_id=PILZ, planner_id="LIN", goal_constraints=[{"position_constraints": [ball(0.3, 0.0, 0.2)]}])
    assert isinstance(read, PlanRequest)
    assert isinstance(read.problem, CartesianProblem)


def test_an_unknown_planner_of_pilz_is_point_to_point_and_told() -> None:
    read = asked(pipeline_id=PILZ, planner_id="SPLINE")
    assert isinstance(read, PlanRequest)
    assert isinstance(read.problem, PlanningProblem)
    assert "'SPLINE'" in read.warnings[0]


# As scripts on roslibpy send them: no tolerances, no header, no times, no scaling.
SPARSE = {
    "joints": {"goal_constraints": [{"joint_constraints": [{"joint_name": "elbow_flex", "position": 0.5}]}]},
    "diff": {"start_state": {"is_diff": True}, "goal_constraints": [GOAL]},
    "state": {"start_state": {"joint_state": {"name": ["elbow_flex"], "position": [0.1]}}, "goal_constraints": [GOAL]},
    "pose": {
        "group_name": "arm",
        "goal_constraints": [
            {
                "position_constraints": [
                    {"link_name": "gripper_frame_link", "constraint_region": {"primitive_poses": [{}]}}
                ],
                "orientation_constraints": [{"link_name": "gripper_frame_link"}],
            }
        ],
    },
}


@pytest.mark.parametrize("sparse", SPARSE.values(), ids=SPARSE.keys())
def test_sparse_requests_are_understood(sparse) -> None:
    assert isinstance(asked(**sparse), PlanRequest)
