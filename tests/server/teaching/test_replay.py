"""Replays of taught motions: goals read, and motions made of them."""

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.waiting import until
from planners.goals import JointGoal
from planners.problem import JointPathProblem, MoveItErrorCode, PlanningFailure, PlanningProblem
from robot.trajectory import Trajectory
from server.execution.goal import Answer, GoalState, Progress
from server.execution.motions import Performed, PlannedMotion
from server.graph.actions import ActionGoal, GoalStatus
from server.teaching.replay import MAX_REPEAT, NAME, groups_of, offer_replay, planned, result
from server.teaching.taught_motion import MotionFiles, TaughtMotion
from tests.helpers.fake_arm import HOME, JOINTS, FakeArm
from tests.helpers.moveit import ROBOT, SEVEN, ActionDesk, planning_of, rejection

POINTS = np.linspace(0.1, 0.5, 11)[:, np.newaxis] * np.ones(len(JOINTS))
WAVE = TaughtMotion(JOINTS, np.arange(11) * 0.3, POINTS)


@pytest.fixture
async def desk(tmp_path: Path) -> ActionDesk:
    """The action with one taught motion."""
    made, motions = ActionDesk(), MotionFiles(tmp_path, ROBOT)
    offer_replay(made.graph, made.context, motions, made.queue)
    await motions.save("wave", WAVE)
    return made


async def replay(desk: ActionDesk, **goal: Any) -> ActionGoal:
    """Ask for a replay, and wait until it is asked of the executor."""
    sent = await desk.send(NAME, name="wave", **goal)
    await until(lambda: desk.asked)
    return sent


def problems(motion: PlannedMotion) -> list[Any]:
    return [step.problem(HOME) for step in motion.steps]


def test_a_replay_goes_to_the_start_of_each_group_and_then_follows_all_joints() -> None:
    arm, gripper, path = problems(planned(WAVE, 1.0, 0, planning_of(FakeArm())))
    assert isinstance(arm, PlanningProblem)
    assert isinstance(path, JointPathProblem)
    assert (arm.group, gripper.group) == ("arm", "gripper")
    assert arm.goal == JointGoal(dict.fromkeys(JOINTS[:-1], 0.1))
    assert (path.joint_names, path.positions_rad.tolist()) == (JOINTS, POINTS.tolist())


async def test_a_replay_backwards_begins_at_the_end_and_is_repeated(desk: ActionDesk) -> None:
    await replay(desk, speed=0.5, reverse=True, repeat=1)
    arm, _, path, *again = problems(desk.asked[0])
    assert arm.goal == JointGoal(dict.fromkeys(JOINTS[:-1], 0.5))
    assert path.positions_rad.tolist() == POINTS[::-1].tolist()
    assert (path.speed, len(again)) == (0.5, 3)


def test_joints_that_make_no_group_without_others_are_refused() -> None:
    assert [group.name for group in groups_of(ROBOT, frozenset(JOINTS))] == ["arm", "gripper"]
    failure = rejection(groups_of, ROBOT, frozenset({"elbow_flex", "gripper"}))
    assert "elbow_flex" in failure.message
    assert groups_of(SEVEN, frozenset(SEVEN.groups[SEVEN.default_group].joints))


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"speed": -1.0}, "speed: must be above 0 and at most 2, not -1"),
        ({"speed": 2.1}, "not 2.1"),
        ({"repeat": MAX_REPEAT + 1}, f"repeat: must be 0 to {MAX_REPEAT}"),
        ({"name": "dance"}, "saved are: wave"),
    ],
)
async def test_a_wrong_field_is_refused(desk: ActionDesk, fields: dict[str, Any], says: str) -> None:
    await desk.send(NAME, **({"name": "wave"} | fields))
    await until(lambda: desk.results)
    assert (desk.results[0].status, desk.asked) == (GoalStatus.ABORTED, [])
    assert says in desk.results[0].values["message"]


async def test_a_replay_is_a_goal_with_feedback_and_a_result_that_can_be_cancelled(desk: ActionDesk) -> None:
    await replay(desk, speed=0.0)
    assert problems(desk.asked[0])[-1].speed == 1.0
    desk.report(Progress(GoalState.EXECUTING, "moving", 0.25, 3.0))
    assert desk.feedback[-1] == {"state": "executing", "fraction": 0.25, "remaining_s": 3.0}
    desk.finish()
    await until(lambda: desk.results)
    desk.asked.clear()
    (await replay(desk)).cancel()
    await until(lambda: len(desk.results) == 2)
    assert [result.status for result in desk.results] == [GoalStatus.SUCCEEDED, GoalStatus.CANCELED]
    assert desk.results[0].values["error_code"]["val"] == 1


def test_a_refusal_says_where_without_the_number_of_the_step() -> None:
    failure = PlanningFailure(
        MoveItErrorCode.INVALID_MOTION_PLAN, "items[2]: at 1.20 s of the motion would touch: crate", {"item": 2}
    )
    assert result(Answer.of(failure))["message"] == "at 1.20 s of the motion would touch: crate"


async def test_a_slower_replay_names_the_place(desk: ActionDesk, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    await replay(desk)
    slow = Trajectory(JOINTS, 2.0 * WAVE.time_s, POINTS, np.zeros_like(POINTS), np.zeros_like(POINTS))
    desk.finish(Answer(MoveItErrorCode.SUCCESS, "there", performed=Performed({}, (slow,))))
    await until(lambda: desk.results)
    words = "took 3.00 s longer than asked for, most of all at"
    assert words in desk.results[0].values["message"]
    assert f"the replay of 'wave' {words}" in caplog.text
