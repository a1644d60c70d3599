"""The actions of move_group."""

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

from planners.problem import MoveItErrorCode, PlanningProblem
from server.execution.goal import Answer, GoalRequest, GoalState, Progress, TimeLimits
from server.execution.motions import Performed, PlannedMotion
from server.graph.actions import GoalStatus
from server.moveit.actions.joint_trajectory_controller import TrajectoryContext
from server.moveit.actions.move_group import (
    DEFAULT_ATTEMPTS,
    EXECUTE_ACTION,
    MAX_ATTEMPTS,
    MOVE_ACTIONS,
    SEQUENCE_ACTION,
    PlanningGoal,
    move_group_result,
    offer_execute_trajectory,
    offer_planning_actions,
    plan_only,
    planned_motion,
    read_planning_goal,
    sequence_result,
)
from server.moveit.requests.planning_problems import PILZ
from tests.helpers.fake_arm import HOME, settle
from tests.helpers.motions import smooth_move
from tests.helpers.moveit import ROBOT, ActionDesk, ServiceRig, assert_refused, ball, joint, message, outcome


@pytest.fixture
async def planning_desk() -> AsyncIterator[ActionDesk]:
    made = ActionDesk()
    offer_planning_actions(made.graph, made.context, made.queue)
    yield made
    await made.close()


def to(position_rad: float) -> dict[str, Any]:
    constraint = {"joint_constraints": [joint("shoulder_pan", position_rad)]}
    return {"group_name": "arm", "goal_constraints": [constraint]}


def codes(planning_desk: ActionDesk) -> list[int]:
    return [result.values["error_code"]["val"] for result in planning_desk.results]


@pytest.mark.parametrize("name", MOVE_ACTIONS)
async def test_a_goal_under_both_names_gets_each_state_and_result_once(planning_desk: ActionDesk, name: str) -> None:
    await planning_desk.send(name, request=to(0.3))
    for state in (GoalState.PLANNING, GoalState.EXECUTING, GoalState.EXECUTING):
        planning_desk.report(Progress(state, ""))
    planning_desk.finish()
    await settle()
    assert [message["state"] for message in planning_desk.feedback] == ["PLANNING", "MONITOR", "IDLE"]
    assert [result.status for result in planning_desk.results] == [GoalStatus.SUCCEEDED]
    assert codes(planning_desk) == [1]


async def test_a_cancelled_goal_ends_and_says_who_cancelled_it(planning_desk: ActionDesk) -> None:
    goal = await planning_desk.send("/move_group", request=to(0.3))
    goal.cancel()
    await settle()
    assert planning_desk.results[0].status == GoalStatus.CANCELED
    assert planning_desk.results[0].values["error_code"]["message"] == "cancelled by a client of /move_group"


async def test_a_goal_that_is_over_takes_its_motion_along_and_leaves_others_alone(planning_desk: ActionDesk) -> None:
    first = planning_desk.queue.submit(GoalRequest("/moveit_goal_pose", PlannedMotion((), frozenset({"gripper"}))))
    goal = await planning_desk.send("/move_group", request=to(0.3))
    goal.fail("Action /move_group took more than 3600 s")
    await settle()
    assert planning_desk.queue.busy(["shoulder_pan"]) == ""
    assert not first.answered.done()


async def test_a_goal_over_before_its_turn_is_still(planning_desk: ActionDesk, monkeypatch: pytest.MonkeyPatch) -> None:
    await planning_desk.send("/move_group", request=to(0.3))
    monkeypatch.setattr(planning_desk, "preempt", lambda _reason: None)
    goal = await planning_desk.send("/move_group", request=to(0.5))
    assert planning_desk.queue.waiting_count == 1
    goal.fail("over")
    assert planning_desk.queue.waiting_count == 0


def test_a_result_has_start_planned_and_executed_motion_and_time() -> None:
    first, second = smooth_move({"shoulder_pan": (0.0, 0.2)}, 1.0), smooth_move({"shoulder_pan": (0.2, 0.3)}, 2.0)
    performed = Performed({"shoulder_pan": 0.0}, (first, second), second, 0.25)
    written = move_group_result(Answer(MoveItErrorCode.SUCCESS, "there", performed=performed), ROBOT)
    result = message("moveit_msgs/action/MoveGroup_Result", **written)
    assert result["error_code"] == {"val": 1, "message": "there", "source": "armbridge"}
    assert result["trajectory_start"]["joint_state"]["name"] == ["shoulder_pan"]
    assert len(result["planned_trajectory"]["joint_trajectory"]["points"]) == len(first.time_s)
    assert len(result["executed_trajectory"]["joint_trajectory"]["points"]) == len(second.time_s)
    assert result["planning_time"] == 0.25


async def test_a_bad_goal_is_answered_while_another_moves(planning_desk: ActionDesk) -> None:
    await planning_desk.send("/move_group", request=to(0.3))
    await planning_desk.send("/move_group", request={"group_name": "leg"})
    await planning_desk.send("/move_group", request=to(0.3), planning_options={"replan_delay": -1.0})
    assert codes(planning_desk) == [-15, 99999]
    assert len(planning_desk.asked) == 1


async def test_a_plan_only_goal_does_not_disturb_the_motion(planning_desk: ActionDesk) -> None:
    await planning_desk.send("/move_group", request=to(0.3))
    await planning_desk.send("/move_group", request=to(0.5), planning_options={"plan_only": True})
    assert codes(planning_desk) == [1]
    assert len(planning_desk.asked) == 1
    assert [message["state"] for message in planning_desk.feedback] == ["PLANNING", "IDLE"]
    assert planning_desk.results[0].values["planned_trajectory"]["joint_trajectory"]["points"]


async def test_a_plan_alone_ends_with_its_goal(planning_desk: ActionDesk, monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[str] = []

    async def never(*_request: object) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            ended.append("planning")

    monkeypatch.setattr(planning_desk.pool, "ask", never)
    goal = await planning_desk.send("/move_group", request=to(0.5), planning_options={"plan_only": True})
    goal.fail("took more than 3600 s")
    await settle()
    assert ended == ["planning"]
    assert len(planning_desk.results) == 1


async def test_a_bug_in_planning_is_answered(
    planning_desk: ActionDesk, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def broken(*_request: object) -> None:
        raise ValueError("broken")

    monkeypatch.setattr(planning_desk.pool, "ask", broken)
    await planning_desk.send("/move_group", request=to(0.5), planning_options={"plan_only": True})
    assert codes(planning_desk) == [99999]
    assert "broken" in caplog.text


async def test_a_sequence_is_one_motion_of_several_steps(planning_desk: ActionDesk) -> None:
    items = [{"req": to(0.3)}, {"req": to(0.5)}]
    await planning_desk.send(SEQUENCE_ACTION, request={"items": items})
    assert isinstance(planning_desk.asked[0], PlannedMotion)
    assert len(planning_desk.asked[0].steps) == 2
    planning_desk.finish()
    await settle()
    assert planning_desk.results[0].values["response"]["error_code"]["val"] == 1


GOAL = {"group_name": "arm", "goal_constraints": [{"joint_constraints": [joint("shoulder_pan", 0.3)]}]}


@pytest.fixture
async def rig() -> ServiceRig:
    return ServiceRig()


def asked(request: dict[str, Any], **options: Any) -> PlanningGoal:
    return read_planning_goal([message("MotionPlanRequest", **request)], message("PlanningOptions", **options))


async def test_the_problem_is_made_for_the_start_that_counts_when_the_goals_turn_comes(rig: ServiceRig) -> None:
    motion = planned_motion(asked(GOAL), rig.context)
    later_rad = {**HOME, "elbow_flex": 0.2}
    problem = motion.steps[0].problem(later_rad)
    assert isinstance(problem, PlanningProblem)
    assert problem.start_rad == later_rad


async def test_a_start_state_is_ignored_with_a_warning_if_the_arm_is_to_move(rig: ServiceRig) -> None:
    start = {"joint_state": {"name": ["elbow_flex"], "position": [1.0]}}
    motion = planned_motion(asked({**GOAL, "start_state": start}), rig.context)
    assert any("start_state is ignored" in warning for warning in motion.warnings)


async def test_a_motion_is_planned_in_the_scene_with_the_diff(rig: ServiceRig) -> None:
    box = {"id": "box", "primitives": [{"type": 1, "dimensions": [0.1, 0.1, 0.1]}]}
    box["pose"] = {"position": {"x": 2.0}}
    diff = {"world": {"collision_objects": [box]}}
    motion = planned_motion(asked(GOAL, planning_scene_diff=diff), rig.context)
    assert motion.scene is not None
    scene = motion.scene(HOME)
    assert [one.name for one in scene.objects] == ["box"]
    assert rig.scene_state.scene.objects == ()


async def test_a_plan_alone_starts_where_the_request_says(rig: ServiceRig) -> None:
    start = {"joint_state": {"name": ["elbow_flex"], "position": [0.5]}, "is_diff": True}
    request = {**GOAL, "start_state": start}
    answer = await plan_only(asked(request), rig.client, rig.context)
    assert answer.code is MoveItErrorCode.SUCCESS
    assert answer.performed is not None
    assert answer.performed.start_rad["elbow_flex"] == 0.5
    assert answer.performed.planned[0].positions_rad[-1, 0] == pytest.approx(0.3)


async def test_a_plan_that_cannot_be_had_has_its_own_code_and_data(rig: ServiceRig) -> None:
    request = {"group_name": "arm", "start_state": {"joint_state": {"name": ["knee"], "position": [0.0]}}}
    answer = await plan_only(asked(request), rig.client, rig.context)
    assert answer.code is MoveItErrorCode.INVALID_ROBOT_STATE
    assert "knee" in answer.message


async def test_a_plan_alone_that_fails_says_what_would_work(rig: ServiceRig) -> None:
    far = {"position_constraints": [ball(0.8, 0.0, 0.2)]}
    free = await plan_only(asked({"goal_constraints": [far]}), rig.client, rig.context)
    assert free.code is MoveItErrorCode.NO_IK_SOLUTION
    assert "what would work: that point" in move_group_result(free, ROBOT)["error_code"]["message"]
    line = {"goal_constraints": [far], "pipeline_id": PILZ, "planner_id": "LIN"}
    straight = await plan_only(asked(line), rig.client, rig.context)
    for result in (move_group_result(straight, ROBOT), sequence_result(straight, ROBOT)["response"]):
        assert result["error_code"]["message"] == straight.message
        assert "what would work: the same path to (" in straight.message


@pytest.mark.parametrize(("wanted", "attempts"), [(0, DEFAULT_ATTEMPTS), (3, 3), (100_000, MAX_ATTEMPTS)])
def test_planning_anew_has_moveits_default_and_a_bound(wanted: int, attempts: int) -> None:
    assert asked(GOAL, replan=True, replan_attempts=wanted).attempts == attempts


@pytest.mark.parametrize("field", ["look_around_attempts", "replan_attempts"])
def test_a_negative_number_of_attempts_is_rejected_by_name(field: str) -> None:
    assert_refused(
        outcome(lambda: asked(GOAL, **{field: -1})),
        MoveItErrorCode.FAILURE,
        f"planning_options.{field} must be 0 or more, not -1",
    )


@pytest.fixture
async def execution_desk() -> AsyncIterator[ActionDesk]:
    made = ActionDesk()
    offer_execute_trajectory(made.graph, TrajectoryContext(made.context, made.queue, TimeLimits()))
    yield made
    await made.close()


def trajectory(position_rad: float, seconds: int = 2) -> dict[str, object]:
    point = {"positions": [position_rad], "time_from_start": {"sec": seconds}}
    return {"joint_trajectory": {"joint_names": ["elbow_flex"], "points": [point]}}


async def test_a_trajectory_without_points_is_done_at_once(execution_desk: ActionDesk) -> None:
    await execution_desk.send(EXECUTE_ACTION)
    assert execution_desk.results[0].values["error_code"]["val"] == 1
    assert execution_desk.asked == []


TOO_LONG = "trajectory.points[0].time_from_start is 3600 s, longer than goals.max_trajectory_duration_s = 600"


@pytest.mark.parametrize(("bad", "words"), [(trajectory(9.0), "elbow_flex"), (trajectory(0.5, 3600), TOO_LONG)])
async def test_a_bad_trajectory_stops_no_motion(execution_desk: ActionDesk, bad: dict[str, object], words: str) -> None:
    await execution_desk.send(EXECUTE_ACTION, trajectory=trajectory(0.5))
    await execution_desk.send(EXECUTE_ACTION, trajectory=bad)
    assert [result.values["error_code"]["val"] for result in execution_desk.results] == [-2]
    assert words in execution_desk.results[0].values["error_code"]["message"]
    assert len(execution_desk.asked) == 1


async def test_multi_dof_joints_are_only_logged(execution_desk: ActionDesk, caplog: pytest.LogCaptureFixture) -> None:
    await execution_desk.send(EXECUTE_ACTION, trajectory={"multi_dof_joint_trajectory": {"points": [{}]}})
    assert "multi_dof_joint_trajectory is ignored" in caplog.text
