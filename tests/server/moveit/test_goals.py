from __future__ import annotations

import math
from typing import Any

import pytest

from planners.goals import JointGoal, PositionGoal
from planners.problem import MoveItErrorCode, PlanningFailure
from protocol.messages import Stamp, complete
from protocol.registry import Registry
from robot import model
from server.moveit.goals import GoalTranslator, MotionRequest
from server.moveit.parameters import MoveItParameters

REGISTRY = Registry.load()
TRANSLATOR = GoalTranslator(model.builtin(), MoveItParameters())


def joint_state(**fields: Any) -> dict[str, Any]:
    return complete(REGISTRY, "sensor_msgs/JointState", fields, Stamp(0, 0))


def pose_stamped(frame: str, **position: float) -> dict[str, Any]:
    message = {"header": {"frame_id": frame}, "pose": {"position": position}}
    return complete(REGISTRY, "geometry_msgs/PoseStamped", message, Stamp(0, 0))


def refusal(answer: MotionRequest | PlanningFailure) -> PlanningFailure:
    assert isinstance(answer, PlanningFailure)
    return answer


def request(answer: MotionRequest | PlanningFailure) -> MotionRequest:
    assert isinstance(answer, MotionRequest)
    return answer


@pytest.mark.parametrize("name", ["ready", "Ready", " READY\n", "re ady"])
def test_a_named_target_is_found_whatever_its_case_and_blanks(name: str) -> None:
    goal = request(TRANSLATOR.named({"data": name})).goal
    assert isinstance(goal, JointGoal)
    assert goal.positions_rad["shoulder_lift"] == -0.5


@pytest.mark.parametrize("name", ["", "redy", "home2"])
def test_an_unknown_named_target_is_answered_with_those_that_exist(name: str) -> None:
    failure = refusal(TRANSLATOR.named({"data": name}))
    assert failure.code is MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert repr(name) in failure.message
    assert failure.details["known"] == ["extended", "home", "ready", "rest"]


def test_only_the_named_joints_are_in_the_goal() -> None:
    goal = request(TRANSLATOR.joints(joint_state(name=["wrist_roll", "elbow_flex"], position=[0.1, 0.2]))).goal
    assert goal == JointGoal({"wrist_roll": 0.1, "elbow_flex": 0.2}, tolerance_rad=0.01)


def test_joints_outside_the_group_are_ignored_with_a_warning() -> None:
    asked = request(TRANSLATOR.joints(joint_state(name=["knee", "elbow_flex", "gripper"], position=[1.0, 0.2, 0.5])))
    assert asked.goal == JointGoal({"elbow_flex": 0.2}, tolerance_rad=0.01)
    assert "knee, gripper" in asked.warnings[0]


BAD_JOINTS = {
    "lengths differ": (["elbow_flex"], [], "1 entries and position 0"),
    "nobody known": (["knee"], [0.1], "no joint of group arm"),
    "empty": ([], [], "no joint of group arm"),
    "named twice": (["elbow_flex", "elbow_flex"], [0.1, 0.2], "elbow_flex is named more than once"),
    "not a number": (["elbow_flex"], [math.nan], "elbow_flex: position must be a finite number, not nan"),
    "infinite": (["elbow_flex"], [math.inf], "elbow_flex: position must be a finite number, not inf"),
}


@pytest.mark.parametrize(("name", "position", "words"), BAD_JOINTS.values(), ids=BAD_JOINTS.keys())
def test_a_senseless_joint_goal_is_refused_with_its_reason(name: list[str], position: list[float], words: str) -> None:
    failure = refusal(TRANSLATOR.joints(joint_state(name=name, position=position)))
    assert failure.code is MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert words in failure.message


@pytest.mark.parametrize("frame", ["", "base_link", "/base_link"])
def test_a_pose_in_the_planning_frame_asks_for_the_position_of_the_tip(frame: str) -> None:
    goal = request(TRANSLATOR.pose(pose_stamped(frame, x=0.3, y=0.1, z=0.2))).goal
    assert goal == PositionGoal("gripper_frame_link", (0.3, 0.1, 0.2), tolerance_m=0.01)


@pytest.mark.parametrize(("frame", "why"), [("moon", "is not known"), ("wrist_link", "moves with the arm")])
def test_a_pose_in_another_frame_is_refused_with_the_frames_that_serve(frame: str, why: str) -> None:
    failure = refusal(TRANSLATOR.pose(pose_stamped(frame, x=0.3)))
    assert failure.code is MoveItErrorCode.FRAME_TRANSFORM_FAILURE
    assert frame in failure.message
    assert why in failure.message
    assert "base_link" in failure.message


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_coordinate_that_is_no_number_is_named(axis: str) -> None:
    failure = refusal(TRANSLATOR.pose(pose_stamped("", **{axis: math.nan})))
    assert failure.code is MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert f"position.{axis}" in failure.message


def test_link_and_tolerance_come_from_the_parameters() -> None:
    parameters = MoveItParameters(end_effector_link="wrist_link", position_tolerance=0.02)
    goal = request(GoalTranslator(model.builtin(), parameters).pose(pose_stamped("", x=0.3))).goal
    assert goal == PositionGoal("wrist_link", (0.3, 0.0, 0.0), tolerance_m=0.02)
