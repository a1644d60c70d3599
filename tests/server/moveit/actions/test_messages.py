from __future__ import annotations

from planners.problem import MoveItErrorCode
from robot import model
from server.goal_queue import Answer, Performed
from server.moveit.actions.goal_bridge import move_group_result, sequence_result
from tests.helpers.moveit_requests import message
from tests.helpers.trajectories import smooth_move

ROBOT = model.builtin()
FIRST, SECOND = smooth_move({"shoulder_pan": (0.0, 0.2)}, 1.0), smooth_move({"shoulder_pan": (0.2, 0.3)}, 2.0)
DONE = Answer(
    MoveItErrorCode.SUCCESS, "there", performed=Performed({"shoulder_pan": 0.0}, (FIRST, SECOND), SECOND, 0.25)
)


def test_a_result_tells_start_plan_way_and_time() -> None:
    result = message("moveit_msgs/action/MoveGroup_Result", **move_group_result(DONE, ROBOT))
    assert result["error_code"] == {"val": 1, "message": "there", "source": "armbridge"}
    assert result["trajectory_start"]["joint_state"]["name"] == ["shoulder_pan"]
    assert len(result["planned_trajectory"]["joint_trajectory"]["points"]) == len(FIRST.time_s)
    assert len(result["executed_trajectory"]["joint_trajectory"]["points"]) == len(SECOND.time_s)
    assert result["planning_time"] == 0.25


def test_a_goal_for_which_nothing_was_done_has_a_complete_result_too() -> None:
    result = message(
        "moveit_msgs/action/MoveGroup_Result", **move_group_result(Answer(MoveItErrorCode.PREEMPTED, "no"), ROBOT)
    )
    assert result["error_code"]["val"] == -7
    assert result["planned_trajectory"]["joint_trajectory"]["points"] == []
    assert result["executed_trajectory"]["joint_trajectory"]["points"] == []


def test_the_result_of_a_sequence_has_every_motion() -> None:
    response = message("moveit_msgs/action/MoveGroupSequence_Result", **sequence_result(DONE, ROBOT))["response"]
    lengths = [len(motion["joint_trajectory"]["points"]) for motion in response["planned_trajectories"]]
    assert lengths == [len(FIRST.time_s), len(SECOND.time_s)]
    assert response["sequence_start"]["joint_state"]["name"] == ["shoulder_pan"]
