"""Goals of actions on their way to the queue and back."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from planners.problem import MoveItErrorCode
from server.execution.goal import Answer, GoalPolicy, GoalRequest, GoalState, Progress
from server.execution.motions import Performed, PlannedMotion
from server.graph.actions import Goal, GoalStatus
from server.graph.node import Node
from server.moveit.actions.goal_bridge import submit_goal
from server.moveit.actions.move_group import MoveGroupFeedback, move_group_result
from tests.helpers.fake_arm import settle
from tests.helpers.motions import smooth_move
from tests.helpers.moveit import JOINTS, ActionDesk, message
from tests.helpers.robots import so101

ACTION, TYPE = "/move", "moveit_msgs/action/ExecuteTrajectory"


class Desk(ActionDesk):
    def __init__(self) -> None:
        super().__init__()
        self.cancelled: list[str] = []
        # True to go on with a goal that another preempts.
        self.hold = False
        self.graph.actions.offer(Node("server"), ACTION, TYPE, self.start)

    def preempt(self, reason: str) -> None:
        if not self.hold:
            ActionDesk.cancel(self, reason)

    def start(self, goal: Goal) -> None:
        submit_goal(goal, self.queue, PlannedMotion((), frozenset(JOINTS)), MoveGroupFeedback(), code)

    def cancel(self, reason: str) -> None:
        self.cancelled.append(reason)
        super().cancel(reason)


def code(answer: Answer) -> dict[str, object]:
    return {"error_code": {"val": int(answer.code), "message": answer.message}}


@pytest.fixture
async def desk() -> AsyncIterator[Desk]:
    made = Desk()
    yield made
    await made.close()


async def test_a_goal_gets_each_state_once_and_then_its_result(desk: Desk) -> None:
    await desk.send(ACTION)
    for state in (GoalState.PLANNING, GoalState.EXECUTING, GoalState.EXECUTING):
        desk.report(Progress(state, ""))
    desk.finish()
    await settle()
    assert [message["state"] for message in desk.feedback] == ["PLANNING", "MONITOR", "IDLE"]
    assert [(result.status, result.values["error_code"]["val"]) for result in desk.results] == [(4, 1)]


async def test_a_cancelled_goal_ends_and_says_who_cancelled_it(desk: Desk) -> None:
    goal = await desk.send(ACTION)
    assert goal is not None
    goal.cancel()
    await settle()
    assert desk.results[0].status == GoalStatus.CANCELED
    assert desk.results[0].values["error_code"]["message"] == "cancelled by a client of /move"


async def test_a_goal_that_is_over_takes_its_motion_along(desk: Desk) -> None:
    goal = await desk.send(ACTION)
    assert goal is not None
    goal.fail("Action /move took more than 3600 s")
    await settle()
    assert desk.cancelled == ["the goal of /move is over: Action /move took more than 3600 s"]
    assert desk.queue.running() is None


async def test_a_goal_that_is_over_before_its_turn_never_moves(desk: Desk) -> None:
    desk.queue.submit(GoalRequest("/moveit_goal_pose", PlannedMotion((), frozenset(JOINTS)), policy=GoalPolicy.QUEUE))
    await settle()
    desk.hold = True
    goal = await desk.send(ACTION)
    assert goal is not None
    assert desk.queue.waiting_count == 1
    goal.fail("over")
    assert desk.queue.waiting_count == 0


async def test_a_goal_that_ended_with_its_motion_leaves_the_next_alone(desk: Desk) -> None:
    await desk.send(ACTION)
    desk.finish()
    await settle()
    assert [result.status for result in desk.results] == [GoalStatus.SUCCEEDED]
    assert desk.cancelled == []


ROBOT = so101()
FIRST, SECOND = smooth_move({"shoulder_pan": (0.0, 0.2)}, 1.0), smooth_move({"shoulder_pan": (0.2, 0.3)}, 2.0)
DONE = Answer(
    MoveItErrorCode.SUCCESS, "there", performed=Performed({"shoulder_pan": 0.0}, (FIRST, SECOND), SECOND, 0.25)
)


def test_a_result_has_start_planned_and_executed_motion_and_time() -> None:
    result = message("moveit_msgs/action/MoveGroup_Result", **move_group_result(DONE, ROBOT))
    assert result["error_code"] == {"val": 1, "message": "there", "source": "armbridge"}
    assert result["trajectory_start"]["joint_state"]["name"] == ["shoulder_pan"]
    assert len(result["planned_trajectory"]["joint_trajectory"]["points"]) == len(FIRST.time_s)
    assert len(result["executed_trajectory"]["joint_trajectory"]["points"]) == len(SECOND.time_s)
    assert result["planning_time"] == 0.25
