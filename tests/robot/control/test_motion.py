from __future__ import annotations

import numpy as np

from robot import model
from robot.control.motion import SETTLED_TICKS, Motion
from robot.guard_limits import GuardLimits
from robot.limits import JointBounds
from robot.messages import Execute, Outcome
from tests.helpers.trajectories import smooth_move

NAMES = ("shoulder_pan", "gripper")
BOUNDS = JointBounds.of(model.builtin(), NAMES)
LIMITS = GuardLimits()


def at_its_end(limits: GuardLimits = LIMITS, **options: bool) -> tuple[Motion, np.ndarray]:
    motion = Motion(Execute(1, smooth_move({"gripper": (0.0, 1.0)}, 1.0), **options), NAMES, BOUNDS, limits)
    motion.playback.advance(2.0)
    return motion, np.array([0.0, 1.0])


def test_a_motion_has_arrived_when_its_joints_have_settled() -> None:
    motion, goal = at_its_end()
    ends = [motion.end(goal, goal, tick / 100) for tick in range(SETTLED_TICKS)]
    assert ends[:-1] == [None] * (SETTLED_TICKS - 1)
    assert ends[-1] is not None
    assert ends[-1].outcome is Outcome.REACHED


def test_joints_outside_the_motion_do_not_count() -> None:
    motion, goal = at_its_end()
    elsewhere = goal + np.array([0.5, 0.0])
    ends = [motion.end(goal, elsewhere, tick / 100) for tick in range(SETTLED_TICKS)]
    assert ends[-1] is not None


def test_a_joint_that_does_not_settle_is_told() -> None:
    motion, goal = at_its_end()
    short = goal - 0.1
    assert motion.end(goal, short, 0.0) is None
    end = motion.end(goal, short, LIMITS.settle_timeout_s)
    assert end is not None
    assert end.outcome is Outcome.NOT_SETTLED
    assert "gripper" in end.message


def test_a_gripper_that_stays_short_of_its_goal_has_gripped() -> None:
    motion, goal = at_its_end(gripping=True)
    motion.end(goal, goal - 0.1, 0.0)
    end = motion.end(goal, goal - 0.1, LIMITS.settle_timeout_s)
    assert end is not None
    assert end.outcome is Outcome.GRIPPED


def test_how_near_and_how_soon_can_be_set() -> None:
    limits = GuardLimits(goal_tolerance_rad=0.2, settle_timeout_s=3.0)
    motion, goal = at_its_end(limits)
    ends = [motion.end(goal, goal - 0.19, tick / 100) for tick in range(SETTLED_TICKS)]
    assert ends[-1] is not None
    assert ends[-1].outcome is Outcome.REACHED
    motion, goal = at_its_end(limits)
    assert [motion.end(goal, goal - 0.21, now_s) for now_s in (0.0, 2.9)] == [None, None]
    end = motion.end(goal, goal - 0.21, 3.0)
    assert end is not None
    assert "3 s after the end of the motion (tolerance 0.2 rad)" in end.message
