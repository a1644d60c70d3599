"""From goal configurations to one timed motion that was checked as it will be driven."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray

from planners.joint_space import CHECK_STEP_M, JointSpace
from planners.path import search
from planners.profile import RateLimits
from planners.timing import time_path
from robot.trajectory import Trajectory

Vector = NDArray[np.float64]

# The timed curve is checked twice as finely as the path was.
FINAL_STEP_M = CHECK_STEP_M / 2.0

# A glance at a straight line before it is timed: most blocked ones are found out here.
QUICK_STEP_M = 4.0 * CHECK_STEP_M

# Corners are rounded widely first; where that touches something, less, and at last the arm stops in each corner.
BLENDS_RAD = (0.3, 0.075, 0.0)


@dataclass(frozen=True)
class Task:
    """Move from a point of the joint space to any one of the goals.

    Attributes:
        space: the joints that move.
        joint_names: their names.
        limits: how fast they may.
        start: shape (n,) [rad].
        goals: free points, the soonest first.
    """

    space: JointSpace
    joint_names: tuple[str, ...]
    limits: RateLimits
    start: Vector
    goals: Sequence[Vector]

    def straight_motion(self) -> Trajectory | None:
        """The motion on the straight joint line to the first goal that has a free one."""
        for goal in self.goals:
            if self.space.line_free(self.start, goal, QUICK_STEP_M):
                motion = self._checked_motion(np.array([self.start, goal]), blend_rad=0.0)
                if motion is not None:
                    return motion
        return None

    def searched_motion(self, seed: int, attempts: int, should_stop: Callable[[], bool]) -> Trajectory | None:
        """The shortest in time of the motions that independent searches find.

        Args:
            seed: of the first search; the next ones count on.
            attempts: how many searches to make; there are more while none has led to a motion.
            should_stop: asked all the time; what was found by then is the answer.
        """
        best: Trajectory | None = None
        for attempt in count():
            if should_stop() or (attempt >= attempts and best is not None):
                break
            path = search(self.space, self.start, self.goals, seed + attempt, should_stop)
            motion = None if path is None else self._rounded_motion(path)
            if motion is not None and (best is None or motion.duration_s < best.duration_s):
                best = motion
        return best

    def _rounded_motion(self, path: Vector) -> Trajectory | None:
        motions = (self._checked_motion(path, blend_rad) for blend_rad in BLENDS_RAD)
        return next((motion for motion in motions if motion is not None), None)

    def _checked_motion(self, path: Vector, blend_rad: float) -> Trajectory | None:
        """Time a path and check the curve that the samples describe."""
        motion = time_path(path, self.joint_names, self.limits, blend_rad)
        if motion is None or not self._free(motion):
            return None
        return motion

    def _free(self, motion: Trajectory) -> bool:
        return self.space.curve_free(motion.positions_rad, FINAL_STEP_M)
