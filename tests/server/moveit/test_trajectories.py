"""Trajectories in messages."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from planners.problem import MoveItErrorCode
from robot.trajectory import Trajectory
from server.errors import RefusedError
from server.moveit.trajectories import (
    external_motion,
    knot_accelerations,
    knot_velocities,
    read_joint_trajectory,
    to_message,
)
from tests.helpers.fake_arm import HOME
from tests.helpers.messages import time_message
from tests.helpers.moveit import ROBOT, assert_refused, message, outcome
from tests.helpers.resources import examples

JOINTS = ("shoulder_pan", "elbow_flex")


def at(time_s, *positions, **fields):
    return {"positions": list(positions), "time_from_start": time_message(time_s), **fields}


def read(*points, names=JOINTS, start_rad=HOME):
    trajectory = message("trajectory_msgs/JointTrajectory", joint_names=list(names), points=list(points))
    return outcome(read_joint_trajectory, trajectory, ROBOT, start_rad)


def test_a_motion_comes_back_from_its_message() -> None:
    random = np.random.default_rng(1)
    positions, velocities, accelerations = random.uniform(-1.0, 1.0, (3, 4, 2))
    velocities[-1] = 0.0
    one = Trajectory(JOINTS, np.array([0.0, 0.25, 1.5, 2.0]), positions, velocities, accelerations)
    sent = message("RobotTrajectory", **to_message(one, "base_link"))
    back = read_joint_trajectory(sent["joint_trajectory"], ROBOT, HOME)
    assert back.joint_names == one.joint_names
    for name in ("time_s", "positions_rad", "velocities_rad_s", "accelerations_rad_s2"):
        assert getattr(back, name) == pytest.approx(getattr(one, name))


def test_a_first_point_after_the_start_is_reached_from_rest_and_a_last_point_in_motion_is_brought_to_it() -> None:
    moved = read(at(1.0, 0.3, 0.4, velocities=[0.3, 0.1]), start_rad=HOME | {"elbow_flex": 0.1})
    assert moved.time_s.tolist() == [0.0, 1.0]
    assert moved.positions_rad.tolist() == [[0.0, 0.1], [0.3, 0.4]]
    assert moved.velocities_rad_s.tolist() == [[0.0, 0.0], [0.0, 0.0]]


def test_motions_that_were_put_together_by_hand_are_one_motion() -> None:
    """The end of one and the begin of the next are the same point at the same time, give or take a nanosecond."""
    ways = (0.0, 0.0), (1.0, 0.2), (1.0 - 1e-9, 0.2), (2.0, 0.0)
    moved = read(*(at(time_s, way, 0.5 * way, velocities=[0.0, 0.0]) for time_s, way in ways))
    assert moved.time_s.tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(("second", "third"), [(1.0, 1.0), (1.0, 0.5)])
def test_times_that_do_not_increase_are_refused_by_index(second: float, third: float) -> None:
    failure = read(at(0.0, 0.0, 0.0), at(second, 0.1, 0.1), at(third, 0.2, 0.2))
    assert assert_refused(failure, MoveItErrorCode.INVALID_MOTION_PLAN, "points[2]").details["index"] == 2


SECOND = {"positions": [0.1, 0.1], "time_from_start": {"sec": 1, "nanosec": 10**9}}
BAD = [
    ({"names": ()}, [at(0.0)], ("joint_names is empty",)),
    ({"names": ("knee",)}, [at(1.0, 0.1)], ("'knee'", "elbow_flex")),
    ({"names": ("elbow_flex", "elbow_flex")}, [at(1.0, 0.1, 0.1)], ("more than once",)),
    ({}, [], ("0 entries",)),
    ({}, [at(1.0, velocities=[0.1, 0.1])], ("positions must be given",)),
    ({}, [at(1.0, 0.1)], ("points[0].positions has 1 values for 2 joints",)),
    ({}, [at(1.0, 0.1, 0.1, velocities=[0.0])], ("points[0].velocities has 1 values",)),
    ({}, [at(0.0, 0.0, 0.0), at(1.0, math.nan, 0.1)], ("points[1].positions",)),
    ({}, [at(0.0, 0.0, 0.0), SECOND], ("points[1].time_from_start.nanosec", "1000000000")),
    ({}, [at(-1.0, 0.1, 0.1)], ("points[0].time_from_start", "-1")),
]


@pytest.mark.parametrize(("fields", "points", "words"), BAD)
def test_a_senseless_motion_is_refused_by_field(fields, points, words) -> None:
    assert_refused(read(*points, **fields), MoveItErrorCode.INVALID_MOTION_PLAN, *words)


POSITIONS = st.floats(-2.0, 2.0)
STEPS = st.lists(st.tuples(st.floats(0.05, 3.0), POSITIONS), min_size=1, max_size=8)


def through(time_s, positions):
    velocities = knot_velocities(time_s, positions)
    return Trajectory(("j",), time_s, positions, velocities, knot_accelerations(time_s, positions, velocities))


@examples(60)
@given(POSITIONS, STEPS)
@example(0.0, [(1.0, 1e-310), (1.0, 1.0)])
def test_the_curve_stays_between_each_two_points(first, steps) -> None:
    spans, positions = zip(*steps, strict=True)
    time_s = np.concatenate(([0.0], np.cumsum(spans)))
    curve = through(time_s, np.array([first, *positions])[:, np.newaxis])
    for i in range(len(spans)):
        values = [curve.sample(t)[0][0] for t in np.linspace(time_s[i], time_s[i + 1], 12)]
        ends = curve.positions_rad[i : i + 2, 0]
        assert min(ends) - 1e-9 <= min(values)
        assert max(values) <= max(ends) + 1e-9


def test_accelerations_are_the_mean_of_those_before_and_after_a_point() -> None:
    time_s, positions = np.array([0.0, 1.0, 3.0]), np.array([[0.0], [1.0], [0.5]])
    velocities = np.array([[0.2], [0.7], [-0.4]])
    accelerations = knot_accelerations(time_s, positions, velocities)
    curve = Trajectory(("j",), time_s, positions, velocities, accelerations)
    around = [curve.sample(1.0 - 1e-9)[2][0], curve.sample(1.0 + 1e-9)[2][0]]
    assert accelerations[1, 0] == pytest.approx(np.mean(around), rel=1e-6)


HELD = {joint.name: 0.01 * index for index, joint in enumerate(ROBOT.movable_joints)}


def played_by_arm(names: list[str], *points: tuple[int, list[float]]) -> Trajectory:
    rows: list[dict[str, Any]] = [{"time_from_start": {"sec": sec}, "positions": at} for sec, at in points]
    read = message("trajectory_msgs/msg/JointTrajectory", joint_names=names, points=rows)
    return external_motion(read, ROBOT).trajectory(HELD, 0.0, None)


def test_joints_that_are_not_named_stay_where_they_are_and_joints_of_several_groups_are_refused() -> None:
    played = played_by_arm(["elbow_flex", "shoulder_pan"], (2, [0.5, -0.5]))
    assert played.joint_names == ROBOT.groups["arm"].joints
    ends = dict(zip(played.joint_names, played.positions_rad[-1].tolist(), strict=True))
    assert ends == {**{name: HELD[name] for name in played.joint_names}, "elbow_flex": 0.5, "shoulder_pan": -0.5}
    assert played.positions_rad[0].tolist() == [HELD[name] for name in played.joint_names]
    with pytest.raises(RefusedError, match="not all of one group; the groups are arm: "):
        played_by_arm(["elbow_flex", "gripper"], (2, [0.5, 0.5]))
