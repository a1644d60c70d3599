"""The first part of a path of the tip."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planners.problem import Line
from planners.scene import Pose
from robot.trajectory import Vector

# Quaternions so nearly alike that the arc between them has no direction.
ALIKE = 1.0 - 1e-9


def length_m(start: Pose, lines: Sequence[Line]) -> float:
    """Length of a path of straight lines [m]."""
    points = np.array([start.position_m, *(line.end.position_m for line in lines)])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def cut_lines(start: Pose, lines: Sequence[Line], along_m: float) -> tuple[Line, ...]:
    """The lines up to a length, the last of them shortened.

    Args:
        start: where the first one begins.
        lines: the path.
        along_m: how much of it is wanted [m].
    """
    kept: list[Line] = []
    before, left_m = start, along_m
    for line in lines:
        this_m = length_m(before, [line])
        if left_m <= this_m:
            share = left_m / this_m if this_m > 0.0 else 1.0
            return (*kept, Line(_between(before, line.end, share)))
        kept.append(line)
        before, left_m = line.end, left_m - this_m
    return tuple(kept)


def _between(first: Pose, second: Pose, share: float) -> Pose:
    a, b = np.array(first.position_m), np.array(second.position_m)
    x, y, z = (a + share * (b - a)).tolist()
    turned = _slerp(np.array(first.orientation), np.array(second.orientation), share)
    qx, qy, qz, qw = turned.tolist()
    return Pose((x, y, z), (qx, qy, qz, qw))


def _slerp(first: Vector, second: Vector, share: float) -> Vector:
    """The unit quaternion between two others, on the shorter arc."""
    cosine = float(first @ second)
    if cosine < 0.0:
        second, cosine = -second, -cosine
    if cosine > ALIKE:
        return second
    angle = float(np.arccos(cosine))
    turned: Vector = (np.sin((1.0 - share) * angle) * first + np.sin(share * angle) * second) / np.sin(angle)
    return turned
