"""The actions of move_group."""

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

from harness.waiting import until
from planners.problem import MoveItErrorCode
from server.execution.goal import Answer, GoalRequest, GoalState, Progress
from server.execution.motions import Performed, PlannedMotion
from server.graph.actions import GoalStatus
from server.moveit.actions import move_group
from server.moveit.trajectories import POINTS_AT_ONCE
from tests.helpers.fake_arm import HOME, settle
from tests.helpers.motions import smooth_move
from tests.helpers.moveit import (
    ROBOT,
    ActionDesk,
    ServiceRig,
    assert_refused,
    box,
    joint,
    message,
    pose,
    rejection,
)


@pytest.fixture
async def desk() -> AsyncIterator[ActionDesk]:
    made = ActionDesk()
    move_group.offer_planning_actions(made.graph, made.context, made.queue)
    move_group.offer_execute_trajectory(made.graph, made.context, made.queue)
    yield made
    await made.close()


def to(position_rad: float) -> dict[str, Any]:
    constraint = {"joint_constraints": [joint("shoulder_pan", position_rad)]}
    return {"group_name": "arm", "goal_constraints": [constraint]}


def codes(desk: ActionDesk) -> list[int]:
    return [result.values["error_code"]["val"] for result in desk.results]


@pytest.mark.parametrize("name", move_group.MOVE_ACTIONS)
async def test_a_goal_under_both_names_gets_each_state_and_result_once(desk: ActionDesk, name: str) -> None:
    await desk.send(name, request=to(0.3))
    for state in (GoalState.PLANNING, GoalState.EXECUTING, GoalState.EXECUTING):
        desk.report(Progress(state, ""))
    desk.finish()
    await settle()
    assert [message["state"] for message in desk.feedback] == ["PLANNING", "MONITOR", "IDLE"]
    assert [result.status for result in desk.results] == [GoalStatus.SUCCEEDED]
    assert codes(desk) == [1]


async def test_a_goal_that_is_cancelled_or_over_takes_its_motion_along_and_says_who_ended_it(desk: ActionDesk) -> None:
    (await desk.send("/move_group", request=to(0.3))).cancel()
    await settle()
    assert desk.results[0].status == GoalStatus.CANCELED
    assert desk.results[0].values["error_code"]["message"] == "cancelled by a client of /move_group"
    first = desk.queue.submit(GoalRequest("/moveit_goal_pose", PlannedMotion((), frozenset({"gripper"}))))
    goal = await desk.send("/move_group", request=to(0.3))
    goal.fail("Action /move_group took more than 3600 s")
    await settle()
    assert desk.queue.busy(["shoulder_pan"]) == ""
    assert not first.answered.done()


async def test_a_goal_over_before_its_turn_is_still(desk: ActionDesk, monkeypatch: pytest.MonkeyPatch) -> None:
    await desk.send("/move_group", request=to(0.3))
    monkeypatch.setattr(desk, "preempt", lambda _reason: None)
    goal = await desk.send("/move_group", request=to(0.5))
    assert desk.queue.waiting_count == 1
    goal.fail("over")
    assert desk.queue.waiting_count == 0


def test_a_result_has_start_planned_motion_and_time() -> None:
    first, second = smooth_move({"shoulder_pan": (0.0, 0.2)}, 1.0), smooth_move({"shoulder_pan": (0.2, 0.3)}, 2.0)
    performed = Performed({"shoulder_pan": 0.0}, (first, second), 0.25)
    written = move_group.move_group_result(Answer(MoveItErrorCode.SUCCESS, "there", performed=performed), ROBOT)
    result = message("moveit_msgs/action/MoveGroup_Result", **written)
    assert result["error_code"] == {"val": 1, "message": "there", "source": "armbridge"}
    assert result["trajectory_start"]["joint_state"]["name"] == ["shoulder_pan"]
    assert len(result["planned_trajectory"]["joint_trajectory"]["points"]) == len(first.time_s)
    assert result["executed_trajectory"]["joint_trajectory"]["points"] == []
    assert result["planning_time"] == 0.25


@pytest.mark.parametrize("name", [move_group.MOVE_ACTIONS[0], move_group.SEQUENCE_ACTION])
async def test_a_long_motion_is_written_while_others_have_their_turn(desk: ActionDesk, name: str) -> None:
    shown = desk.listen("/display_planned_path", "moveit_msgs/DisplayTrajectory")
    motion = smooth_move({"shoulder_pan": (0.0, 1.0)}, 0.01 * POINTS_AT_ONCE)
    performed = Performed({"shoulder_pan": 0.0}, (motion,), 0.25)
    request = {"items": [{"req": to(0.3)}]} if name == move_group.SEQUENCE_ACTION else to(0.3)
    goal = await desk.send(name, request=request)
    desk.context.display.performed(performed)
    desk.finish(Answer(MoveItErrorCode.SUCCESS, "there", performed=performed))
    await asyncio.sleep(0)
    assert (shown, desk.results) == ([], [])
    await until(lambda: shown and desk.results)
    written = (("moveit_msgs/DisplayTrajectory", shown[0]), (f"{goal.type_name}_Result", desk.results[0].values))
    for type_name, fields in written:
        assert fields == message(type_name, **fields), type_name


async def test_of_long_motions_the_last_is_shown(desk: ActionDesk) -> None:
    shown = desk.listen("/display_planned_path", "moveit_msgs/DisplayTrajectory")
    for joint_name in ("shoulder_pan", "elbow_flex"):
        motion = smooth_move({joint_name: (0.0, 1.0)}, 0.01 * POINTS_AT_ONCE)
        desk.context.display.performed(Performed({joint_name: 0.0}, (motion,)))
    await until(lambda: shown)
    await settle()
    assert [each["trajectory_start"]["joint_state"]["name"] for each in shown] == [["elbow_flex"]]


async def test_a_bad_goal_is_answered_while_another_moves(desk: ActionDesk) -> None:
    await desk.send("/move_group", request=to(0.3))
    await desk.send("/move_group", request={"group_name": "leg"})
    await desk.send("/move_group", request=to(0.3), planning_options={"replan_delay": -1.0})
    assert codes(desk) == [-15, 99999]
    assert len(desk.asked) == 1


async def test_a_plan_only_goal_is_shown_and_does_not_disturb_the_motion(desk: ActionDesk) -> None:
    shown = desk.listen("/display_planned_path", "moveit_msgs/DisplayTrajectory")
    await desk.send("/move_group", request=to(0.3))
    await desk.send("/move_group", request=to(0.5), planning_options={"plan_only": True})
    assert codes(desk) == [1]
    assert len(desk.asked) == 1
    assert [message["state"] for message in desk.feedback] == ["PLANNING", "IDLE"]
    assert shown[-1]["trajectory"] == [desk.results[0].values["planned_trajectory"]]
    assert shown[-1]["trajectory"][0]["joint_trajectory"]["points"]


async def test_a_plan_alone_ends_with_its_goal(desk: ActionDesk, monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[str] = []

    async def never(*_request: object) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            ended.append("planning")

    monkeypatch.setattr(desk.pool, "ask", never)
    goal = await desk.send("/move_group", request=to(0.5), planning_options={"plan_only": True})
    goal.fail("took more than 3600 s")
    await settle()
    assert ended == ["planning"]
    assert len(desk.results) == 1


async def test_a_bug_in_planning_is_answered(
    desk: ActionDesk, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def broken(*_request: object) -> None:
        raise ValueError("broken")

    monkeypatch.setattr(desk.pool, "ask", broken)
    await desk.send("/move_group", request=to(0.5), planning_options={"plan_only": True})
    assert codes(desk) == [99999]
    assert "broken" in caplog.text


async def test_a_sequence_is_one_motion_of_several_steps(desk: ActionDesk) -> None:
    await desk.send(move_group.SEQUENCE_ACTION, request={"items": [{"req": to(0.3)}, {"req": to(0.5)}]})
    assert len(desk.asked[0].steps) == 2
    desk.finish()
    await settle()
    assert desk.results[0].values["response"]["error_code"]["val"] == 1


def options(**fields: Any) -> Any:
    return message("PlanningOptions", **fields)


async def test_a_motion_starts_where_its_turn_comes_and_a_plan_alone_where_the_request_says(rig: ServiceRig) -> None:
    start = {"joint_state": {"name": ["elbow_flex"], "position": [1.0]}}
    changes = {"world": {"collision_objects": [box("box", at=pose(2.0))]}}
    request = message("MotionPlanRequest", **to(0.3), start_state=start)
    motion: Any = move_group.planned_motion([request], options(planning_scene_diff=changes), rig.context)
    later_rad = {**HOME, "elbow_flex": 0.2}
    assert motion.steps[0](later_rad).start_rad == later_rad
    assert any("start_state is ignored" in warning for warning in motion.warnings)
    assert [one.name for one in motion.scene(HOME).objects] == ["box"]
    assert rig.scene_state.scene.objects == ()
    start = {"joint_state": {"name": ["elbow_flex"], "position": [0.5]}, "is_diff": True}
    request = message("MotionPlanRequest", **to(0.3), start_state=start)
    answer: Any = await move_group.plan_only([request], rig.client, rig.context)
    assert answer.code is MoveItErrorCode.SUCCESS
    assert answer.performed.start_rad["elbow_flex"] == 0.5
    assert answer.performed.planned[0].positions_rad[-1, 0] == pytest.approx(0.3)
    nowhere = {"joint_state": {"name": ["knee"], "position": [0.0]}}
    request = message("MotionPlanRequest", **to(0.3), start_state=nowhere)
    refused = await move_group.plan_only([request], rig.client, rig.context)
    assert refused.code is MoveItErrorCode.INVALID_ROBOT_STATE
    assert "knee" in refused.message


def test_planning_anew_has_moveits_default_and_a_bound_and_no_negative_number_of_attempts() -> None:
    for wanted, attempts in ((0, move_group.DEFAULT_ATTEMPTS), (3, 3), (100_000, move_group.MAX_ATTEMPTS)):
        assert move_group.replanning(options(replan=True, replan_attempts=wanted)) == (attempts, 0.0)
    for field in ("look_around_attempts", "replan_attempts"):
        refused = rejection(move_group.replanning, options(**{field: -1}))
        assert_refused(refused, MoveItErrorCode.FAILURE, f"planning_options.{field} must be 0 or more, not -1")


def trajectory(position_rad: float, seconds: int = 2) -> dict[str, object]:
    point = {"positions": [position_rad], "time_from_start": {"sec": seconds}}
    return {"joint_trajectory": {"joint_names": ["elbow_flex"], "points": [point]}}


async def test_a_trajectory_without_points_is_done_at_once(desk: ActionDesk, caplog: pytest.LogCaptureFixture) -> None:
    await desk.send(move_group.EXECUTE_ACTION, trajectory={"multi_dof_joint_trajectory": {"points": [{}]}})
    assert (codes(desk), desk.asked) == ([1], [])
    assert "multi_dof_joint_trajectory is ignored" in caplog.text


TOO_LONG = "trajectory.points[0].time_from_start is 3600 s, longer than goals.max_trajectory_duration_s = 600"


@pytest.mark.parametrize(("bad", "words"), [(trajectory(9.0), "elbow_flex"), (trajectory(0.5, 3600), TOO_LONG)])
async def test_a_bad_trajectory_stops_no_motion(desk: ActionDesk, bad: dict[str, object], words: str) -> None:
    await desk.send(move_group.EXECUTE_ACTION, trajectory=trajectory(0.5))
    await desk.send(move_group.EXECUTE_ACTION, trajectory=bad)
    assert codes(desk) == [-2]
    assert words in desk.results[0].values["error_code"]["message"]
    assert len(desk.asked) == 1
