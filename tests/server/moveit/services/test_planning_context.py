from __future__ import annotations

import pytest

from planners.problem import CartesianProblem, MoveItErrorCode, PlanningFailure, PlanningProblem
from server.errors import RefusedError
from server.graph.node import Node
from server.moveit.requests.motion_plan import PILZ
from tests.helpers.moveit_requests import HOME, assert_refused, joint, message
from tests.helpers.moveit_services import ServiceRig

BOX = {"primitives": [{"type": 1, "dimensions": [0.01] * 3}], "primitive_poses": [{}]}
HELD = {"link_name": "gripper_link", "object": {"id": "mug", "header": {"frame_id": "gripper_link"}, **BOX}}


def state(positions=None, **fields):
    positions = positions or {}
    return message("RobotState", joint_state={"name": list(positions), "position": list(positions.values())}, **fields)


@pytest.fixture
def rig() -> ServiceRig:
    return ServiceRig()


def test_a_request_without_a_start_begins_where_the_arm_is(rig: ServiceRig) -> None:
    rig.arm.at_rad = HOME | {"elbow_flex": 0.4}
    assert rig.context.situation(state(), rig.client).start_rad == rig.arm.at_rad


def test_what_a_client_assumes_counts_for_itself_alone(rig: ServiceRig) -> None:
    rig.assumed.by_node[rig.client] = {"elbow_flex": 0.7}
    assert rig.context.situation(state(), rig.client).start_rad == HOME | {"elbow_flex": 0.7}
    assert rig.context.situation(state(), Node("other")).start_rad == HOME


def test_what_a_request_says_counts_before_what_its_client_assumes(rig: ServiceRig) -> None:
    rig.assumed.by_node[rig.client] = {"elbow_flex": 0.7, "wrist_roll": 0.1}
    start = rig.context.situation(state({"elbow_flex": 0.2}), rig.client).start_rad
    assert start == HOME | {"elbow_flex": 0.2, "wrist_roll": 0.1}


def test_an_arm_that_is_not_read_is_no_start(rig: ServiceRig) -> None:
    rig.arm.at_rad = None
    with pytest.raises(RefusedError) as raised:
        rig.context.situation(state(), rig.client)
    assert_refused(raised.value.failure, MoveItErrorCode.ROBOT_STATE_STALE)


def test_the_scene_is_the_present_one_unless_something_is_attached(rig: ServiceRig) -> None:
    assert rig.context.situation(state(HOME), rig.client).scene is rig.scene_state.scene


def test_what_a_start_state_attaches_is_held_for_this_request_alone(rig: ServiceRig) -> None:
    scene = rig.context.situation(state(is_diff=True, attached_collision_objects=[HELD]), rig.client).scene
    assert [held.object.name for held in scene.attached] == ["mug"]
    assert not rig.scene_state.scene.attached


def test_a_whole_start_state_drops_what_it_does_not_name(rig: ServiceRig) -> None:
    diff = message("PlanningScene", is_diff=True, robot_state={"is_diff": True, "attached_collision_objects": [HELD]})
    assert rig.scene_state.apply_diff(diff, HOME) is None
    assert rig.context.situation(state(), rig.client).scene.attached
    assert not rig.context.situation(state(HOME, is_diff=False), rig.client).scene.attached


def test_an_unknown_group_is_refused(rig: ServiceRig) -> None:
    with pytest.raises(RefusedError) as raised:
        rig.context.group("manipulator")
    assert_refused(raised.value.failure, MoveItErrorCode.INVALID_GROUP_NAME, "'manipulator'")


def request(**fields):
    goal = {"joint_constraints": [joint("elbow_flex", 0.5)]}
    return message("MotionPlanRequest", **{"goal_constraints": [goal], **fields})


def test_a_step_makes_its_problem_for_any_start(rig: ServiceRig) -> None:
    step = rig.context.step(request())
    for start_rad in (HOME, HOME | {"wrist_roll": 0.3}):
        problem = step(start_rad)
        assert isinstance(problem, PlanningProblem)
        assert problem.start_rad == start_rad


def test_a_step_may_be_a_path_of_the_tip(rig: ServiceRig) -> None:
    assert isinstance(rig.context.step(request(pipeline_id=PILZ, planner_id="LIN"))(HOME), CartesianProblem)


def test_a_step_that_cannot_be_is_refused_when_its_turn_comes(rig: ServiceRig) -> None:
    assert isinstance(rig.context.step(request(goal_constraints=[]))(HOME), PlanningFailure)


def test_parameters_that_were_set_count_for_requests(rig: ServiceRig) -> None:
    rig.context.parameters.set("arm", "", {"num_planning_attempts": "3"}, replace=False)
    problem = rig.context.step(request())(HOME)
    assert isinstance(problem, PlanningProblem)
    assert problem.attempts == 3
