from __future__ import annotations

import numpy as np
import pytest

from robot.control.motion import Motion, splice_refusal
from robot.control.streaming import Streaming
from robot.description.limits import JointBounds
from robot.messages import Continuation, Execute, GuardLimits
from robot.trajectory import Trajectory
from tests.helpers.motions import smooth_move
from tests.helpers.robots import so101

NAMES = ("shoulder_pan", "elbow_flex", "gripper")
BOUNDS = JointBounds.of(so101(), NAMES)
LIMITS = GuardLimits()
PATH = smooth_move({"shoulder_pan": (0.0, 1.0), "elbow_flex": (0.0, -0.5)}, 2.0)


def in_progress(gripping: bool = False) -> list[Motion | Streaming]:
    """One motion, half done."""
    motion = Motion(Execute(7, PATH, gripping), NAMES, BOUNDS, LIMITS)
    for _ in range(100):
        motion.step(0.01, 1.0, 1.0)
    return [motion]


def since(from_s: float, **changes: tuple[float, float]) -> Trajectory:
    """The same motion from a time on, or another one."""
    path = smooth_move({"shoulder_pan": (0.0, 1.0), "elbow_flex": (0.0, -0.5), **changes}, 2.0)
    kept = path.time_s >= from_s - 1e-9
    arrays = (path.positions_rad[kept], path.velocities_rad_s[kept], path.accelerations_rad_s2[kept])
    return Trajectory(path.joint_names, path.time_s[kept] - from_s, *arrays)


def asked(motions: list[Motion | Streaming], trajectory: Trajectory, number: int = 7, from_s: float = 0.9) -> str:
    command = Execute(8, trajectory, continues=Continuation(number, from_s))
    return splice_refusal(motions, command, NAMES, BOUNDS, np.array([0.5, -0.25, 0.0]))


REFUSED = {
    "no such motion": (since(0.9), 6, 0.9, "not in progress"),
    "it is past that place": (since(1.2), 7, 1.2, "no longer where"),
    "another path": (since(0.9, elbow_flex=(0.0, 0.5)), 7, 0.9, "the motion starts with joint elbow_flex"),
    "other joints": (smooth_move({"gripper": (0.0, 1.0)}, 2.0), 7, 0.0, "other joints"),
    "beyond a limit": (smooth_move({"shoulder_pan": (0.0, 9.0), "elbow_flex": (0.0, -0.5)}, 9.0), 7, 0.0, "limits"),
}


@pytest.mark.parametrize(("trajectory", "number", "from_s", "words"), REFUSED.values(), ids=REFUSED.keys())
def test_a_motion_that_would_jump_is_refused(trajectory: Trajectory, number: int, from_s: float, words: str) -> None:
    assert words in asked(in_progress(), trajectory, number, from_s)


def test_nothing_takes_the_place_of_a_grip() -> None:
    assert "a grip" in asked(in_progress(gripping=True), since(0.9))


def test_nothing_takes_the_place_of_a_motion_that_brakes() -> None:
    motions = in_progress()
    motions[0].stop()
    assert asked(motions, since(0.9)) != ""
