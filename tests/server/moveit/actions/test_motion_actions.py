from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from server.moveit.actions.move_group import MotionActions
from tests.helpers.action_desk import ActionDesk

OFFERED = {
    "/move_action": "moveit_msgs/action/MoveGroup",
    "/move_group": "moveit_msgs/action/MoveGroup",
    "/sequence_move_group": "moveit_msgs/action/MoveGroupSequence",
    "/execute_trajectory": "moveit_msgs/action/ExecuteTrajectory",
    "/arm_controller/follow_joint_trajectory": "control_msgs/action/FollowJointTrajectory",
    "/joint_trajectory_action": "control_msgs/action/FollowJointTrajectory",
}


@pytest.fixture
async def desk() -> AsyncIterator[ActionDesk]:
    made = ActionDesk()
    MotionActions(made.graph, made.context, made.played_arm, made.queue).open(())  # type: ignore[arg-type]
    yield made
    await made.close()


async def test_every_action_is_offered_under_its_names(desk: ActionDesk) -> None:
    assert desk.graph.actions.types() == OFFERED


async def test_every_action_has_the_topics_of_actionlib(desk: ActionDesk) -> None:
    types = desk.graph.topic_types()
    for name, type_name in OFFERED.items():
        package, _, action = type_name.split("/")
        assert types[f"{name}/goal"] == f"{package}/msg/{action}ActionGoal"
        assert types[f"{name}/feedback"] == f"{package}/msg/{action}ActionFeedback"
        assert types[f"{name}/result"] == f"{package}/msg/{action}ActionResult"
        assert types[f"{name}/cancel"] == "actionlib_msgs/msg/GoalID"
        assert types[f"{name}/status"] == "actionlib_msgs/msg/GoalStatusArray"
