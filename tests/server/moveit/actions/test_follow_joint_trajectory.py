from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import pytest

from server.action_goals import GoalStatus
from server.goal_queue import GoalState, Progress
from server.moveit.actions.joint_trajectory_controller import INDUSTRIAL_ACTION, ArmController, FollowCode
from server.moveit.motions import GivenMotion
from tests.helpers.action_desk import ActionDesk
from tests.helpers.moveit_services import ROBOT
from tests.helpers.played_arm import settle

ACTION = "/arm_controller/follow_joint_trajectory"
TOPIC = "/arm_controller/joint_trajectory"
TRAJECTORY = {"joint_names": ["elbow_flex"], "points": [{"positions": [0.3], "time_from_start": {"sec": 2}}]}
MOVING = Progress(GoalState.EXECUTING, "", 0.5, 1.0)


class Desk(ActionDesk):
    def __init__(self) -> None:
        super().__init__()
        self.controller = ArmController(
            self.graph,
            ROBOT,
            ROBOT.groups["arm"],
            self.played_arm,  # type: ignore[arg-type]
            self.arm,  # type: ignore[arg-type]
            self.queue,
        )
        self.controller.open()

    async def publish(self, **trajectory: Any) -> None:
        self.graph.publish(self.client, TOPIC, trajectory)
        await settle()

    @property
    def codes(self) -> list[tuple[int, int]]:
        return [(result.status, result.values["error_code"]) for result in self.results]


@pytest.fixture
async def desk() -> AsyncIterator[Desk]:
    made = Desk()
    yield made
    await made.close()


@pytest.mark.parametrize("action", [ACTION, INDUSTRIAL_ACTION])
async def test_a_trajectory_is_played_under_both_names(desk: Desk, action: str) -> None:
    await desk.send(action, trajectory=TRAJECTORY)
    assert isinstance(desk.asked[0], GivenMotion)
    desk.report(MOVING)
    desk.finish()
    await settle()
    assert desk.codes == [(GoalStatus.SUCCEEDED, FollowCode.SUCCESSFUL)]
    assert len(desk.feedback) == 1


async def test_a_refused_goal_is_answered_with_code_and_sentence(desk: Desk) -> None:
    await desk.send(ACTION, trajectory={**TRAJECTORY, "joint_names": ["knee"]})
    await desk.send(ACTION, trajectory=TRAJECTORY, goal_time_tolerance={"sec": 60})
    assert desk.codes == [
        (GoalStatus.ABORTED, FollowCode.INVALID_JOINTS),
        (GoalStatus.ABORTED, FollowCode.INVALID_GOAL),
    ]
    assert "'knee'" in desk.results[0].values["error_string"]
    assert len(desk.refused) == 2
    assert desk.asked == []


async def test_a_new_goal_preempts_the_old_one(desk: Desk) -> None:
    await desk.send(ACTION, trajectory=TRAJECTORY)
    await desk.send(INDUSTRIAL_ACTION, trajectory=TRAJECTORY)
    assert desk.codes == [(GoalStatus.CANCELED, FollowCode.INVALID_GOAL)]
    assert "preempted by goal 2" in desk.results[0].values["error_string"]


async def test_a_cancel_ends_the_goal(desk: Desk) -> None:
    goal = await desk.send(ACTION, trajectory=TRAJECTORY)
    assert goal is not None
    goal.cancel()
    await settle()
    assert desk.codes == [(GoalStatus.CANCELED, FollowCode.INVALID_GOAL)]


async def test_leaving_the_path_tolerance_ends_the_goal(desk: Desk) -> None:
    tolerance = [{"name": "elbow_flex", "position": 0.05}]
    await desk.send(ACTION, trajectory=TRAJECTORY, path_tolerance=tolerance)
    desk.report(MOVING)
    arm = desk.played_arm
    measured = arm.state
    arm.put(elbow_flex=0.2)
    lagging = type(measured)(**{**vars(arm.state), "position_rad": measured.position_rad})
    desk.controller.take_state(lagging)
    await settle()
    assert desk.codes == [(GoalStatus.ABORTED, FollowCode.PATH_TOLERANCE_VIOLATED)]


async def test_a_trajectory_on_the_topic_is_played_in_place_of_what_moves(desk: Desk) -> None:
    await desk.send(ACTION, trajectory=TRAJECTORY)
    await desk.publish(**TRAJECTORY)
    assert len(desk.asked) == 2
    assert desk.codes == [(GoalStatus.CANCELED, FollowCode.INVALID_GOAL)]


async def test_an_empty_trajectory_on_the_topic_stops_the_arm(desk: Desk) -> None:
    await desk.send(ACTION, trajectory=TRAJECTORY)
    await desk.publish(joint_names=["elbow_flex"])
    assert len(desk.asked) == 1
    assert "stopped by an empty trajectory" in desk.results[0].values["error_string"]


async def test_a_wrong_trajectory_on_the_topic_is_told_and_disturbs_nothing(desk: Desk) -> None:
    await desk.send(ACTION, trajectory=TRAJECTORY)
    await desk.publish(joint_names=["knee"], points=TRAJECTORY["points"])
    assert len(desk.asked) == 1
    assert "'knee'" in desk.refused[0]
