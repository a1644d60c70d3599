"""Recordings that become motions: their rests, their smoothing, their parts, and their messages."""

import asyncio
import json
import re
from pathlib import Path

import numpy as np
import pytest

from planners.motions.path_timing import time_along
from planners.motions.spline import NaturalSpline
from planners.problem import RateLimits
from robot.trajectory import Trajectory, Vector
from server.errors import RefusedError, ServiceError
from server.teaching import taught_motion
from server.teaching.taught_motion import (
    KEPT_REST_S,
    MAX_DURATION_S,
    TOLERANCE_RAD,
    MotionFiles,
    TaughtMotion,
    from_message,
    moving,
    of_recording,
)
from tests.helpers.moveit import ROBOT, message

NAMES = ("shoulder_pan", "elbow_flex")
RATE_HZ = 50.0


def recording(lasts_s: float, seed: int = 0, tremble_rad: float = 0.004) -> tuple[Vector, Vector]:
    """A hand that moves two joints, with a second of rest before and two after it, and trembles."""
    rng = np.random.default_rng(seed)
    knots = np.linspace(0.0, lasts_s, max(2, round(lasts_s)) + 1)
    targets = rng.uniform(-0.8, 0.8, (len(knots), 2))
    targets[0] = 0.0
    time_s = np.arange(0.0, lasts_s + 3.0, 1.0 / RATE_HZ)
    at = np.clip(time_s - 1.0, 0.0, lasts_s)
    # A cosine from target to target: a hand speeds up and slows down.
    i = np.minimum((at / knots[1]).astype(int), len(knots) - 2)
    share = 0.5 - 0.5 * np.cos(np.pi * (at / knots[1] - i))
    clean = targets[i] + share[:, np.newaxis] * (targets[i + 1] - targets[i])
    return time_s, clean + rng.uniform(-tremble_rad, tremble_rad, clean.shape)


WHOLE = TaughtMotion(NAMES[:1], 0.5 * np.arange(5), np.array([[0.0], [0.3], [0.1], [0.5], [0.2]]))


def test_a_part_follows_the_same_curve_between_its_times_and_one_that_is_none_is_refused_with_the_limits() -> None:
    part = WHOLE.part(0.7, 1.6)
    assert part.duration_s == pytest.approx(0.9)
    assert part.at(np.array([0.0, 0.9])) == pytest.approx(WHOLE.at(np.array([0.7, 1.6])), abs=1e-5)
    for from_s, to_s, says in (
        (-0.1, 1.0, "must be 0 to 2 s"),
        (0.5, 2.5, "not 0.5 and 2.5"),
        (1.0, 1.0, "from_s before"),
        (1.0, 1.05, "0.1 s"),
    ):
        with pytest.raises(ServiceError, match=says):
            WHOLE.part(from_s, to_s)


@pytest.mark.parametrize("seed", range(8))
def test_a_motion_keeps_within_the_tolerance_of_its_recording_and_is_smoother(seed: int) -> None:
    time_s, positions = recording(6.0, seed)
    made, away_rad = of_recording(NAMES, time_s, positions, ROBOT)
    first, last = moving(time_s, positions)
    away = np.abs(made.at(time_s[first : last + 1] - time_s[first]) - positions[first : last + 1])
    # Rounded to microseconds and microradians.
    assert away.max() == pytest.approx(away_rad, abs=1e-5)
    assert away_rad <= 0.02
    grid_s = np.arange(0.0, made.duration_s, 1.0 / RATE_HZ)
    hand, smooth = np.diff(positions, 3, axis=0), np.diff(made.at(grid_s), 3, axis=0)
    assert np.abs(smooth).max() < 0.2 * np.abs(hand).max()


def test_a_jerk_of_the_hand_is_kept_rather_than_smoothed_away() -> None:
    time_s = np.arange(0.0, 4.0, 1.0 / RATE_HZ)
    jerk = np.clip(time_s - 1.0, 0.0, 2.0) * 0.1 + 0.2 * np.exp(-(((time_s - 2.0) / 0.08) ** 2))
    made, away_rad = of_recording(NAMES, time_s, np.column_stack([jerk, np.zeros_like(jerk)]), ROBOT)
    assert away_rad <= 0.02
    assert made.positions_rad[:, 0].max() > jerk.max() - TOLERANCE_RAD


def test_one_abrupt_start_leaves_the_rest_of_the_motion_smooth_and_as_fast_as_it_was() -> None:
    time_s, positions = recording(6.0)
    positions[time_s > 3.0, 0] += 0.25
    made, away_rad = of_recording(NAMES, time_s, positions, ROBOT)
    assert away_rad <= TOLERANCE_RAD
    # 30 s where the whole motion is as rough as its abrupt start.
    assert replay(made).duration_s < made.duration_s + 4.0


def replay(made: TaughtMotion, speed: float = 1.0) -> Trajectory:
    """Time a motion as planners do."""
    limits = RateLimits.of([ROBOT.joints[name] for name in made.joint_names])
    path = NaturalSpline(made.time_s, made.positions_rad)
    timed = time_along(path, made.joint_names, limits, np.full(len(path.grid), speed))
    assert timed is not None
    return timed


@pytest.mark.parametrize(("joint", "at_s"), [(0, 1.5), (0, 4.0), (1, 1.5), (1, 4.0)])
def test_a_replay_that_is_slower_names_the_time_and_the_joint(joint: int, at_s: float) -> None:
    time_s, positions = recording(6.0)
    cut_s = time_s[moving(time_s, positions)[0]]
    positions[time_s > at_s, joint] += 0.25
    made, _ = of_recording(NAMES, time_s, positions, ROBOT)
    found = re.fullmatch(
        r"(.*) s longer than asked for, most of all at (.*) s of the motion, where joint (.*) would need .* limit",
        made.slowed(1.0, replay(made), ROBOT),
    )
    assert found is not None
    assert float(found[1]) == pytest.approx(replay(made).duration_s - made.duration_s, abs=0.01)
    assert float(found[2]) == pytest.approx(at_s - cut_s, abs=0.1)
    assert found[3] == NAMES[joint]


def test_a_replay_in_its_own_time_is_not_called_slower() -> None:
    time_s, positions = recording(6.0)
    made, _ = of_recording(NAMES, time_s, 0.5 * positions, ROBOT)
    assert made.slowed(1.0, replay(made), ROBOT) == ""
    assert made.slowed(0.5, replay(made, 0.5), ROBOT) == ""


def test_rest_at_both_ends_is_cut_off_but_for_a_moment_and_the_longest_recording_fits_a_message() -> None:
    made, _ = of_recording(NAMES, *recording(4.0, tremble_rad=0.001), ROBOT)
    # The first and the last hundredth of a radian of a slow start and end count as rest as well.
    assert 4.0 - 0.4 < made.duration_s < 4.0 + 2.0 * KEPT_REST_S + 0.05
    made, _ = of_recording(NAMES, *recording(MAX_DURATION_S - 4.0), ROBOT)
    assert len(made.time_s) <= taught_motion.MAX_POINTS


def test_a_motion_keeps_the_limits_that_a_relaxed_arm_was_beyond() -> None:
    time_s, positions = recording(3.0)
    upper = ROBOT.joints["elbow_flex"].upper
    positions[:, 1] += upper - positions[:, 1].max() + 0.05
    made, _ = of_recording(NAMES, time_s, positions, ROBOT)
    assert made.positions_rad[:, 1].max() <= upper + 1e-6


def given(*times_s: int, joint: str = "shoulder_pan") -> dict[str, object]:
    points = [{"positions": [0.1 * i], "time_from_start": {"sec": at, "nanosec": 0}} for i, at in enumerate(times_s)]
    return message("trajectory_msgs/JointTrajectory", joint_names=[joint], points=points)


def test_a_message_that_is_no_motion_is_refused() -> None:
    for trajectory, says in (
        (given(), "points has 0"),
        (given(0), "2 or more"),
        (given(0, 601), "0.1 to 600 s, not 601 s"),
        (given(0, 1, joint="knee"), "unknown joint 'knee'"),
        (given(1, 1), "must be after"),
    ):
        with pytest.raises((RefusedError, ServiceError), match=says):
            from_message(trajectory, ROBOT)


WAVE = TaughtMotion(("elbow_flex", "gripper"), np.array([0.0, 0.5, 1.25]), np.array([[0.0, 1.0], [0.2, 1.0], [0.1, 0]]))


@pytest.fixture
def motions(tmp_path: Path) -> MotionFiles:
    return MotionFiles(tmp_path, ROBOT)


async def test_a_saved_motion_is_the_same_for_the_next_server(motions: MotionFiles, tmp_path: Path) -> None:
    await motions.save("Küche 1", WAVE)
    again = await MotionFiles(tmp_path, ROBOT).load("Küche 1")
    assert (again.joint_names, again.time_s.tolist()) == (WAVE.joint_names, WAVE.time_s.tolist())
    assert again.positions_rad.tolist() == WAVE.positions_rad.tolist()


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".x", " a", "a ", "x" * 51, "\0", "a\nb"])
async def test_a_name_that_is_no_file_is_refused_with_the_limit(motions: MotionFiles, name: str) -> None:
    await motions.save("a", WAVE)
    for change in (motions.load(name), motions.save(name, WAVE), motions.delete(name), motions.check_new(name)):
        with pytest.raises(ServiceError, match=r"^name: must be 1 to 50"):
            await change
    with pytest.raises(ServiceError, match=r"^new_name: must be 1 to 50"):
        await motions.rename("a", name)


async def test_a_taken_name_is_neither_recorded_nor_renamed_to_and_several_at_once_keep_to_their_bound(
    motions: MotionFiles, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(taught_motion, "MAX_MOTIONS", 2)
    bounded = MotionFiles(tmp_path, ROBOT)
    saved = await asyncio.gather(*(bounded.save(name, WAVE) for name in "abcd"), return_exceptions=True)
    assert sum(isinstance(each, ServiceError) for each in saved) == 2
    first, second = await bounded.names()
    await bounded.save(first, WAVE)
    with pytest.raises(ServiceError, match="2 motions are saved already, the limit is 2"):
        await bounded.check_new("e")
    with pytest.raises(ServiceError, match="delete or rename it"):
        await motions.check_new(first)
    with pytest.raises(ServiceError, match=f"there is a motion '{second}' already"):
        await motions.rename(first, second)


GOOD = {"joint_names": ["elbow_flex"], "time_s": [0.0, 1.0], "positions_rad": [[0.0], [0.1]]}


async def test_files_without_a_motion_are_refused(motions: MotionFiles, tmp_path: Path) -> None:
    for content in (
        "{",
        "[]",
        json.dumps(GOOD).replace("0.1", "NaN"),
        {"joint_names": ["knee"]},
        {"joint_names": ["elbow_flex", "elbow_flex"]},
        {"time_s": [0.0]},
        {"time_s": [0.0, 0.0]},
        {"time_s": [0.5, 1.0]},
        {"time_s": [0.0, 601.0]},
        {"positions_rad": [[0.0]]},
        {"positions_rad": [[0.0], [0.1, 0.2]]},
    ):
        await motions.save("wave", WAVE)
        file = tmp_path / "wave.json"
        file.write_text(content if isinstance(content, str) else json.dumps(GOOD | content))
        with pytest.raises(ServiceError, match=r"wave\.json"):
            await motions.load("wave")
