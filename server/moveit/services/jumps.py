"""The jump thresholds of a path of the tip: how far joints may move while the tip moves by a step.

MoveIt looks at points a step apart on the way. The planners' paths have no gaps, so what is found here is not a flip
between two points but a place where joints race: as near a singularity.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robot.description.forward_kinematics import ForwardPlacements
from robot.trajectory import Trajectory, Vector

# Steps up to this exceed no factor: a flip of an elbow or a wrist goes further at once, and where a path begins, five
# joints that turn towards the orientation they are asked for move far above the mean.
LEAST_JUMP_RAD = 1.0

# Where the tip is looked at on the way: often enough that it moves by less than a usual step in between.
SAMPLE_S = 0.02

# Placing the links takes some 0.1 ms; a slow path is looked at more coarsely in time.
MAX_SAMPLES = 500


@dataclass(frozen=True)
class Thresholds:
    """What a step is a jump from.

    Attributes:
        step_rad: of any joint; 0 for none [rad].
        factor: times the mean of the steps; 0 for none.
    """

    step_rad: float
    factor: float

    @property
    def any(self) -> bool:
        """Whether there is one."""
        return self.step_rad > 0.0 or self.factor > 0.0

    def limit_rad(self, steps_rad: Vector) -> float:
        """The greatest step that is none, for the greatest step of any joint at each place, shape (steps,) [rad]."""
        limits = [np.inf]
        if self.step_rad > 0.0:
            limits.append(self.step_rad)
        if self.factor > 0.0:
            limits.append(max(self.factor * float(np.mean(steps_rad)), LEAST_JUMP_RAD))
        return min(limits)


@dataclass(frozen=True)
class Jump:
    """The first step that is too great.

    Attributes:
        along_m: length of the tip's path before it [m].
        joint: which joint.
        step_rad: how far it goes [rad].
        limit_rad: how far it may [rad].
    """

    along_m: float
    joint: str
    step_rad: float
    limit_rad: float


def first_jump(
    motion: Trajectory,
    tip: tuple[ForwardPlacements, str],
    others_rad: Mapping[str, float],
    step_m: float,
    thresholds: Thresholds,
) -> Jump | None:
    """The first jump on a path; None for none.

    Args:
        motion: the motion along the path.
        tip: places the links; the one that follows the path.
        others_rad: position of every joint; that of the motion's does not count [rad].
        step_m: length of a step of the tip [m].
        thresholds: what a jump is.
    """
    configurations = _sampled(motion)
    along_m = _along_m(configurations, motion.joint_names, tip, others_rad)
    places_m = np.append(np.arange(0.0, along_m[-1], step_m), along_m[-1])
    at = np.column_stack([np.interp(places_m, along_m, column) for column in configurations.T])
    steps = np.abs(np.diff(at, axis=0))
    greatest = steps.max(axis=1, initial=0.0)
    if not greatest.size:
        return None
    limit_rad = thresholds.limit_rad(greatest)
    beyond = np.flatnonzero(greatest > limit_rad)
    if not beyond.size:
        return None
    first = int(beyond[0])
    joint = int(np.argmax(steps[first]))
    return Jump(float(places_m[first]), motion.joint_names[joint], float(steps[first, joint]), limit_rad)


def _sampled(motion: Trajectory) -> Vector:
    """Configurations on the way, shape (n, joints) [rad]."""
    count = min(max(2, int(np.ceil(motion.duration_s / SAMPLE_S)) + 1), MAX_SAMPLES)
    return np.array([motion.sample(float(time_s))[0] for time_s in np.linspace(0.0, motion.duration_s, count)])


def _along_m(
    configurations: Vector,
    joint_names: tuple[str, ...],
    tip: tuple[ForwardPlacements, str],
    others_rad: Mapping[str, float],
) -> Vector:
    """Length of the tip's path up to each configuration, shape (n,) [m]."""
    forward, link = tip
    positions = [{**others_rad, **dict(zip(joint_names, q, strict=True))} for q in configurations.tolist()]
    places_m = np.array([forward.transforms(one)[link][:3, 3] for one in positions])
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(places_m, axis=0), axis=1))))
