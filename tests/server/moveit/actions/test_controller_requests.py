from __future__ import annotations

from typing import Any

import pytest

from robot import model
from server.moveit.actions.joint_trajectory_controller import (
    FollowCode,
    FollowedTolerances,
    Refused,
    refusal_of,
    tolerances_in,
)
from tests.helpers.moveit_requests import HOME, message

ROBOT = model.builtin()
ARM = ROBOT.groups["arm"]
NOW_S = 1000.0
POINT = {"positions": [0.3], "time_from_start": {"sec": 2}}
TRAJECTORY: dict[str, Any] = {"joint_names": ["elbow_flex"], "points": [POINT], "header": {"stamp": {"sec": 0}}}


def refusal(**changes: Any) -> Refused | None:
    trajectory = message("trajectory_msgs/msg/JointTrajectory", **{**TRAJECTORY, **changes})
    return refusal_of(trajectory, ARM, ROBOT, HOME, NOW_S)


REFUSED = {
    "no points": ({"points": []}, FollowCode.INVALID_GOAL, "points is empty"),
    "unknown joint": ({"joint_names": ["knee"]}, FollowCode.INVALID_JOINTS, "'knee'"),
    "joint of another controller": ({"joint_names": ["gripper"]}, FollowCode.INVALID_JOINTS, "'gripper'"),
    "stamp in the past": ({"header": {"stamp": {"sec": 990}}}, FollowCode.OLD_HEADER_TIMESTAMP, "8.0 s ago"),
    "no positions": ({"points": [{**POINT, "positions": []}]}, FollowCode.INVALID_GOAL, "positions"),
    "wrong length": ({"points": [{**POINT, "positions": [0.1, 0.2]}]}, FollowCode.INVALID_GOAL, "2 values for 1"),
    "times that go back": (
        {"points": [POINT, {"positions": [0.1], "time_from_start": {"sec": 1}}]},
        FollowCode.INVALID_GOAL,
        "points[1].time_from_start",
    ),
    "beyond the limits": ({"points": [{**POINT, "positions": [9.0]}]}, FollowCode.INVALID_GOAL, "9.000 rad"),
}


@pytest.mark.parametrize(("changes", "code", "words"), REFUSED.values(), ids=REFUSED.keys())
def test_a_trajectory_that_cannot_be_played_is_refused_with_its_code(
    changes: dict[str, Any], code: FollowCode, words: str
) -> None:
    refused = refusal(**changes)
    assert refused is not None
    assert refused.code is code
    assert words in refused.failure.message


TAKEN = {
    "as it is": {},
    "stamp of now": {"header": {"stamp": {"sec": 1000}}},
    "efforts": {"points": [{**POINT, "effort": [0.0]}]},
    "a last point in motion": {"points": [{**POINT, "velocities": [0.5]}]},
}


@pytest.mark.parametrize("changes", TAKEN.values(), ids=TAKEN.keys())
def test_what_other_controllers_reject_without_a_word_is_taken(changes: dict[str, Any]) -> None:
    assert refusal(**changes) is None


def tolerances(**fields: Any) -> FollowedTolerances | Refused:
    return tolerances_in(message("control_msgs/action/FollowJointTrajectory_Goal", **fields), ARM)


def test_tolerances_are_read_by_joint() -> None:
    read = tolerances(
        path_tolerance=[{"name": "elbow_flex", "position": 0.1}], goal_time_tolerance={"sec": 1, "nanosec": 500_000_000}
    )
    assert read == FollowedTolerances({"elbow_flex": 0.1}, {}, 1.5)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"goal_tolerance": [{"name": "knee"}]}, "goal_tolerance names the joint 'knee'"),
        ({"goal_time_tolerance": {"sec": 60}}, "at most 10 s, not 60 s"),
    ],
    ids=["joint", "time"],
)
def test_tolerances_that_cannot_be_kept_are_refused(fields: dict[str, Any], words: str) -> None:
    refused = tolerances(**fields)
    assert isinstance(refused, Refused)
    assert words in refused.failure.message
