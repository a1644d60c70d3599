from __future__ import annotations

import math

import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from robot.trajectory import Trajectory
from server.moveit.requests.trajectories import from_joint_trajectory, to_message
from tests.helpers.moveit_requests import HOME, ROBOT, assert_refused, message

JOINTS = ("shoulder_pan", "elbow_flex")


def at(time_s, *positions, **fields):
    whole = math.floor(time_s)
    stamp = {"sec": whole, "nanosec": round((time_s - whole) * 1e9)}
    return {"positions": list(positions), "time_from_start": stamp, **fields}


def read(*points, names=JOINTS, start_rad=HOME):
    return from_joint_trajectory(
        message("trajectory_msgs/JointTrajectory", joint_names=list(names), points=list(points)), ROBOT, start_rad
    )


def motion(*points, **fields) -> Trajectory:
    found = read(*points, **fields)
    assert isinstance(found, Trajectory), found
    return found


def test_a_motion_comes_back_from_its_message() -> None:
    random = np.random.default_rng(1)
    positions, velocities, accelerations = random.uniform(-1.0, 1.0, (3, 4, 2))
    velocities[-1] = 0.0
    one = Trajectory(JOINTS, np.array([0.0, 0.25, 1.5, 2.0]), positions, velocities, accelerations)
    sent = message("RobotTrajectory", **to_message(one, "base_link"))
    back = from_joint_trajectory(sent["joint_trajectory"], ROBOT, HOME)
    assert isinstance(back, Trajectory)
    assert back.joint_names == one.joint_names
    for name in ("time_s", "positions_rad", "velocities_rad_s", "accelerations_rad_s2"):
        assert getattr(back, name) == pytest.approx(getattr(one, name))


def test_no_motion_is_a_message_without_points() -> None:
    sent = to_message(None)["joint_trajectory"]
    assert sent["points"] == sent["joint_names"] == []


def test_a_message_is_complete_against_its_type() -> None:
    still = Trajectory(JOINTS, np.zeros(1), np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 2)))
    sent = to_message(still, "base_link")
    completed = message("RobotTrajectory", **sent)
    assert completed["joint_trajectory"]["points"] == sent["joint_trajectory"]["points"]


def test_a_first_point_after_the_start_is_reached_from_it_at_rest() -> None:
    moved = motion(at(1.0, 0.3, 0.4), start_rad=HOME | {"elbow_flex": 0.1})
    assert moved.time_s.tolist() == [0.0, 1.0]
    assert moved.positions_rad.tolist() == [[0.0, 0.1], [0.3, 0.4]]
    assert moved.velocities_rad_s.tolist() == [[0.0, 0.0], [0.0, 0.0]]


def test_points_without_velocities_are_joined_smoothly() -> None:
    moved = motion(at(0.0, 0.0, 0.0), at(1.0, 0.2, 0.0), at(2.0, 0.4, 0.0))
    assert moved.velocities_rad_s[:, 0] == pytest.approx([0.0, 0.2, 0.0])


def test_efforts_are_not_heeded() -> None:
    with_effort = motion(at(0.0, 0.0, 0.0), at(1.0, 0.2, 0.1, effort=[0.0, 0.0]))
    assert with_effort.positions_rad.tolist() == motion(at(0.0, 0.0, 0.0), at(1.0, 0.2, 0.1)).positions_rad.tolist()


def test_a_last_point_in_motion_is_brought_to_rest() -> None:
    moved = motion(at(0.0, 0.0, 0.0, velocities=[0.0, 0.0]), at(1.0, 0.2, 0.1, velocities=[0.3, 0.1]))
    assert moved.velocities_rad_s[-1].tolist() == [0.0, 0.0]
    assert moved.positions_rad[-1].tolist() == [0.2, 0.1]


def test_motions_that_were_put_together_by_hand_are_one_motion() -> None:
    """The end of one and the begin of the next are the same point at the same time, give or take a nanosecond."""
    rest = {"velocities": [0.0, 0.0]}
    moved = motion(
        at(0.0, 0.0, 0.0, **rest),
        at(1.0, 0.2, 0.1, **rest),
        at(1.0 - 1e-9, 0.2, 0.1, **rest),
        at(2.0, 0.0, 0.0, **rest),
    )
    assert moved.time_s.tolist() == [0.0, 1.0, 2.0]


def test_a_pause_is_kept() -> None:
    assert motion(at(0.0, 0.0, 0.0), at(1.0, 0.0, 0.0), at(2.0, 0.1, 0.0)).time_s.tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(("second", "third"), [(1.0, 1.0), (1.0, 0.5)])
def test_times_that_do_not_increase_are_refused_by_index(second: float, third: float) -> None:
    failure = read(at(0.0, 0.0, 0.0), at(second, 0.1, 0.1), at(third, 0.2, 0.2))
    assert assert_refused(failure, MoveItErrorCode.INVALID_MOTION_PLAN, "points[2]").details["index"] == 2


BAD = {
    "no joints": ({"names": ()}, [at(0.0)], ("joint_names is empty",)),
    "unknown": ({"names": ("knee",)}, [at(1.0, 0.1)], ("'knee'", "elbow_flex")),
    "twice": ({"names": ("elbow_flex", "elbow_flex")}, [at(1.0, 0.1, 0.1)], ("more than once",)),
    "no points": ({}, [], ("0 entries",)),
    "no positions": ({}, [at(1.0, velocities=[0.1, 0.1])], ("positions must be given",)),
    "too few": ({}, [at(1.0, 0.1)], ("points[0].positions has 1 values for 2 joints",)),
    "velocities": ({}, [at(1.0, 0.1, 0.1, velocities=[0.0])], ("points[0].velocities has 1 values",)),
    "no number": ({}, [at(0.0, 0.0, 0.0), at(1.0, math.nan, 0.1)], ("points[1].positions",)),
    "before": ({}, [at(-1.0, 0.1, 0.1)], ("points[0].time_from_start", "-1")),
}


@pytest.mark.parametrize(("fields", "points", "words"), BAD.values(), ids=BAD.keys())
def test_a_senseless_motion_is_refused_by_field(fields, points, words) -> None:
    assert_refused(read(*points, **fields), MoveItErrorCode.INVALID_MOTION_PLAN, *words)
