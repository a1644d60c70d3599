from __future__ import annotations

from typing import Any

import pytest

from planners.problem import PlanningFailure
from robot import model
from robot.trajectory import Trajectory
from server.moveit.requests.trajectories import given_motion, smallest_group
from tests.helpers.moveit_requests import message

ROBOT = model.builtin()
HELD = {joint.name: 0.01 * index for index, joint in enumerate(ROBOT.movable_joints)}


def motion(names: list[str], *points: tuple[int, list[float]]) -> Trajectory | PlanningFailure:
    rows: list[dict[str, Any]] = [{"time_from_start": {"sec": sec}, "positions": at} for sec, at in points]
    read = message("trajectory_msgs/msg/JointTrajectory", joint_names=names, points=rows)
    return given_motion(read, ROBOT).trajectory(HELD)


def test_joints_that_are_not_named_stay_where_the_arm_holds_them() -> None:
    played = motion(["elbow_flex", "shoulder_pan"], (2, [0.5, -0.5]))
    assert isinstance(played, Trajectory)
    assert played.joint_names == ROBOT.groups["arm"].joints
    ends = dict(zip(played.joint_names, played.positions_rad[-1].tolist(), strict=True))
    assert ends == {**{name: HELD[name] for name in played.joint_names}, "elbow_flex": 0.5, "shoulder_pan": -0.5}
    assert played.positions_rad[0].tolist() == [HELD[name] for name in played.joint_names]


def test_the_gripper_is_moved_alone() -> None:
    played = motion(["gripper"], (2, [0.5]))
    assert isinstance(played, Trajectory)
    assert played.joint_names == ROBOT.groups["gripper"].joints


REFUSED: dict[str, tuple[list[str], list[tuple[int, list[float]]], str]] = {
    "limits": (["elbow_flex"], [(2, [5.0])], "elbow_flex would go to 5.000 rad, beyond its limits"),
    "speed": (["elbow_flex"], [(0, [0.0]), (1, [1.5]), (2, [-1.5])], "elbow_flex would move at"),
    "times": (["elbow_flex"], [(2, [0.1]), (1, [0.2])], "points[1].time_from_start"),
    "groups": (["elbow_flex", "gripper"], [(2, [0.5, 0.5])], "not all of one group"),
    "joint": (["knee"], [(2, [0.5])], "knee"),
}


@pytest.mark.parametrize(("names", "points", "words"), REFUSED.values(), ids=REFUSED.keys())
def test_what_cannot_be_played_is_refused_before_it_disturbs_anything(
    names: list[str], points: list[tuple[int, list[float]]], words: str
) -> None:
    refused = motion(names, *points)
    assert isinstance(refused, PlanningFailure)
    assert words in refused.message


def test_the_group_of_fewest_joints_is_taken() -> None:
    group = smallest_group(ROBOT, ("gripper",))
    assert group is not None
    assert group.name == "gripper"
