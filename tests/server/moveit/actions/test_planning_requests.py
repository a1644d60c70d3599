from __future__ import annotations

from typing import Any

import pytest

from planners.problem import MoveItErrorCode, PlanningFailure, PlanningProblem
from server.action_goals import Goal
from server.moveit.actions.move_group import Asked, asked_by, motion_of, planned_only
from server.moveit.motions import PlannedMotion
from tests.helpers.moveit_requests import joint, message
from tests.helpers.moveit_services import HOME, ServiceRig

GOAL = {"group_name": "arm", "goal_constraints": [{"joint_constraints": [joint("shoulder_pan", 0.3)]}]}


@pytest.fixture
async def rig() -> ServiceRig:
    return ServiceRig()


def goal(rig: ServiceRig, request: dict[str, Any], **options: Any) -> Goal:
    fields = message("moveit_msgs/action/MoveGroup_Goal", request=request, planning_options=options)
    return Goal("/move_group", "moveit_msgs/action/MoveGroup", fields, rig.graph.interfaces, None, rig.client)


def asked(rig: ServiceRig, request: dict[str, Any], **options: Any) -> Asked:
    read = asked_by(goal(rig, request, **options), lambda fields: [fields["request"]])
    assert isinstance(read, Asked)
    return read


async def test_the_problem_is_made_for_the_start_that_counts_when_the_goals_turn_comes(rig: ServiceRig) -> None:
    motion = motion_of(asked(rig, GOAL), rig.context)
    assert isinstance(motion, PlannedMotion)
    later_rad = {**HOME, "elbow_flex": 0.2}
    problem = motion.steps[0](later_rad)
    assert isinstance(problem, PlanningProblem)
    assert problem.start_rad == later_rad


async def test_what_cannot_be_asked_for_is_refused_at_once(rig: ServiceRig) -> None:
    motion = motion_of(asked(rig, {**GOAL, "group_name": "leg"}), rig.context)
    assert isinstance(motion, PlanningFailure)
    assert motion.code is MoveItErrorCode.INVALID_GROUP_NAME


async def test_a_start_state_is_ignored_and_told_when_the_arm_is_to_move(rig: ServiceRig) -> None:
    start = {"joint_state": {"name": ["elbow_flex"], "position": [1.0]}}
    motion = motion_of(asked(rig, {**GOAL, "start_state": start}), rig.context)
    assert isinstance(motion, PlannedMotion)
    assert any("start_state is ignored" in warning for warning in motion.warnings)


async def test_a_scene_difference_is_what_the_motion_is_planned_in(rig: ServiceRig) -> None:
    box = {"id": "box", "primitives": [{"type": 1, "dimensions": [0.1, 0.1, 0.1]}]}
    box["pose"] = {"position": {"x": 2.0}}
    diff = {"world": {"collision_objects": [box]}}
    motion = motion_of(asked(rig, GOAL, planning_scene_diff=diff), rig.context)
    assert isinstance(motion, PlannedMotion)
    assert motion.scene is not None
    scene = motion.scene(HOME)
    assert not isinstance(scene, PlanningFailure)
    assert [one.name for one in scene.objects] == ["box"]
    assert rig.scene_state.scene.objects == ()


async def test_a_plan_alone_starts_where_the_request_says(rig: ServiceRig) -> None:
    start = {"joint_state": {"name": ["elbow_flex"], "position": [0.5]}, "is_diff": True}
    request = {**GOAL, "start_state": start}
    answer = await planned_only(goal(rig, request), asked(rig, request), rig.context)
    assert answer.code is MoveItErrorCode.SUCCESS
    assert answer.performed is not None
    assert answer.performed.start_rad["elbow_flex"] == 0.5
    assert answer.performed.planned[0].positions_rad[-1, 0] == pytest.approx(0.3)


async def test_a_plan_alone_starts_where_its_client_wants_the_arm_to_be(rig: ServiceRig) -> None:
    rig.assumed.by_node[rig.client] = {"elbow_flex": 0.4}
    answer = await planned_only(goal(rig, GOAL), asked(rig, GOAL), rig.context)
    assert answer.performed is not None
    assert answer.performed.start_rad["elbow_flex"] == 0.4


async def test_a_plan_that_cannot_be_had_has_its_own_code_and_data(rig: ServiceRig) -> None:
    request = {"group_name": "arm", "start_state": {"joint_state": {"name": ["knee"], "position": [0.0]}}}
    answer = await planned_only(goal(rig, request), asked(rig, request), rig.context)
    assert answer.code is MoveItErrorCode.INVALID_ROBOT_STATE
    assert "knee" in answer.message
