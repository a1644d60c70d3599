"""Paths of the tip along lines and arcs, and the checks of Cartesian problems, each with its error code."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from planners import checks
from planners.geometry.shapes import as_point, as_pose, placement
from planners.ik.constraints import ROTATION_ARM_M
from planners.problem import Arc, CartesianProblem, Line
from planners.scene import Pose
from robot.description.model import RobotModel
from robot.trajectory import Vector

SHORTEST_M = 1e-7  # shorter pieces are repeated points, which have neither direction nor speed
SMOOTH_TURN_RAD = 1e-3  # directions of neighbouring pieces that differ by less go on smoothly
SHORTEST_CHORD_M = 1e-5  # points nearer to each other do not tell an arc's plane
LARGEST_RADIUS_M = 100.0  # flatter arcs lose digits, and no arm can show that they are not lines
MOST_POINTS = 10_000  # following takes some 0.3 ms a point, 3 s in all


@dataclass(frozen=True)
class _Piece:
    """A line, or an arc around ``center``; the tip turns evenly by ``turn`` about an axis of its own on the way."""

    start_m: float  # length of the path before it [m]
    length_m: float  # its own length [m]
    origin: Vector  # its start, shape (3,) [m]
    along: Vector  # vector to the end of a line; the spoke a quarter ahead of ``spoke`` on an arc [m]
    spoke: Vector  # from the center to the start, on an arc [m]
    angle: float  # of the arc [rad], 0 for a line
    rotation: Vector  # at its start, shape (3, 3)
    turn: Vector  # rotation vector in the tip's frame, shape (3,) [rad]

    def position(self, share: float) -> Vector:
        if self.angle == 0.0:
            return np.asarray(self.origin + share * self.along)
        angle = share * self.angle
        return np.asarray(self.origin + (np.cos(angle) - 1.0) * self.spoke + np.sin(angle) * self.along)

    def direction(self, share: float) -> Vector:
        """Its derivative by the share [m]."""
        if self.angle == 0.0:
            return self.along
        angle = share * self.angle
        return np.asarray(self.angle * (np.cos(angle) * self.along - np.sin(angle) * self.spoke))

    def pose(self, share: float) -> pin.SE3:
        return pin.SE3(self.rotation @ pin.exp3(share * self.turn), self.position(share))

    def part(self, share: float, digits: int) -> Line | Arc:
        """Return a segment for the first share of the piece, its end rounded."""
        end = rounded_pose(self.pose(share), digits)
        if self.angle == 0.0:
            return Line(end)
        return Arc(as_point(self.position(0.5 * share)), end)


class TipPath:
    """Lines and arcs one after the other from ``start``; the parameter is the length.

    ``length_m`` is the whole length, to which turns of the tip contribute, and ``corners_m`` are the lengths at which
    the direction changes, strictly increasing, with the end as the last [m]. Pieces without any length are left out.
    """

    def __init__(self, start: pin.SE3, segments: Sequence[Line | Arc]) -> None:
        self._pieces = [piece for piece, _ in _pieces(start, segments)]
        self._start = start
        self._starts_m = np.array([piece.start_m for piece in self._pieces])
        self.length_m = sum(piece.length_m for piece in self._pieces)
        turns = [
            first.start_m + first.length_m
            for first, second in zip(self._pieces[:-1], self._pieces[1:], strict=True)
            if _is_corner(first, second)
        ]
        self.corners_m = [*turns, self.length_m]

    def at(self, along_m: float) -> pin.SE3:
        """Pose of the tip in the root link's frame after a length of the path [m]."""
        if not self._pieces:
            return self._start
        index = int(np.searchsorted(self._starts_m, along_m, side="right")) - 1
        piece = self._pieces[min(max(index, 0), len(self._pieces) - 1)]
        share = min(1.0, (along_m - piece.start_m) / piece.length_m)
        return piece.pose(share)


def first_part(start: pin.SE3, segments: Sequence[Line | Arc], along_m: float, digits: int) -> tuple[Line | Arc, ...]:
    """Return the segments of a path up to a length, the new end rounded to some decimals."""
    kept: list[Line | Arc] = []
    for piece, segment in _pieces(start, segments):
        if piece.start_m + piece.length_m >= along_m:
            return *kept, piece.part((along_m - piece.start_m) / piece.length_m, digits)
        kept.append(segment)
    return tuple(kept)


def rounded_pose(place: pin.SE3, digits: int) -> Pose:
    """Return a pose as plain data, its position rounded to some decimals."""
    # Minus 0 is a strange number to read.
    return as_pose(pin.SE3(place.rotation, np.round(place.translation, digits) + 0.0))


def apart_m(a: pin.SE3, b: pin.SE3) -> float:
    """Return the distance between the origins of two poses [m]."""
    return float(np.linalg.norm(a.translation - b.translation))


def apart_rad(a: pin.SE3, b: pin.SE3) -> float:
    """Return the angle between the orientations of two poses [rad]."""
    return float(np.linalg.norm(pin.log3(a.rotation.T @ b.rotation)))


def arc_flaw(start_m: Vector, arc: Arc) -> str | None:
    """Return the reason for which three points make no arc, or None."""
    via_m, end_m = np.asarray(arc.via_m), np.asarray(arc.end.position_m)
    sides_m = [float(np.linalg.norm(side)) for side in (via_m - start_m, end_m - via_m, start_m - end_m)]
    if min(sides_m) < SHORTEST_CHORD_M:
        return "two of its three points are the same"
    double_area_m2 = float(np.linalg.norm(np.cross(via_m - start_m, end_m - start_m)))
    if math.prod(sides_m) > 2.0 * double_area_m2 * LARGEST_RADIUS_M:
        return "its three points lie on a line"
    return None


def _pieces(start: pin.SE3, segments: Sequence[Line | Arc]) -> Iterator[tuple[_Piece, Line | Arc]]:
    """Yield the pieces that have a length, each with its segment."""
    along_m = 0.0
    for segment in segments:
        piece = _piece(along_m, start, segment)
        if piece.length_m > SHORTEST_M:
            yield piece, segment
            along_m += piece.length_m
            start = placement(segment.end)


def _piece(start_m: float, start: pin.SE3, segment: Line | Arc) -> _Piece:
    end = placement(segment.end)
    turn = np.asarray(pin.log3(start.rotation.T @ end.rotation))
    along, spoke, angle = end.translation - start.translation, np.zeros(3), 0.0
    if isinstance(segment, Arc):
        along, spoke, angle = _circle(start.translation, np.asarray(segment.via_m), end.translation)
    length_m = float(np.linalg.norm(along)) * (angle or 1.0)
    length_m = max(length_m, ROTATION_ARM_M * float(np.linalg.norm(turn)))
    return _Piece(start_m, length_m, start.translation, along, spoke, angle, start.rotation, turn)


def _circle(start: Vector, via: Vector, end: Vector) -> tuple[Vector, Vector, float]:
    """Return the spoke a quarter ahead of the start, the start's, and the angle from start over via to end."""
    a, b = start - end, via - end
    normal = np.cross(a, b)
    # Circumcenter of a triangle in space, from its third corner.
    center = end + np.cross(a @ a * b - b @ b * a, normal) / (2.0 * normal @ normal)
    spoke = start - center
    # Seen against this normal the arc runs counter-clockwise through start, via and end.
    ahead = np.cross(normal, spoke) / np.linalg.norm(normal)
    via_angle, end_angle = (
        float(np.arctan2((point - center) @ ahead, (point - center) @ spoke)) % (2.0 * np.pi) for point in (via, end)
    )
    if via_angle <= end_angle:
        return ahead, spoke, end_angle
    return -ahead, spoke, 2.0 * np.pi - end_angle


def _is_corner(first: _Piece, second: _Piece) -> bool:
    before, after = first.direction(1.0), second.direction(0.0)
    lengths = float(np.linalg.norm(before) * np.linalg.norm(after))
    across = float(np.linalg.norm(np.cross(before, after)))
    # A tip that turns on the spot starts or ends its turn with a corner.
    return lengths == 0.0 or across > SMOOTH_TURN_RAD * lengths or float(before @ after) < 0.0


def check_path(robot: RobotModel, problem: CartesianProblem) -> None:
    """Check names and numbers of a problem."""
    checks.check_group(robot, problem.group)
    checks.check_constraints(robot, problem.path_constraints)
    checks.check_link(robot, problem.link)
    checks.check_rates(problem)
    positive = [("greatest step [m]", problem.max_step_m)]
    if problem.tip_speed_m_s is not None:
        positive.append(("tip speed [m/s]", problem.tip_speed_m_s))
    if problem.keep_orientation:
        positive.append(("orientation tolerance [rad]", problem.orientation_tolerance_rad))
    for name, value in positive:
        if not (math.isfinite(value) and value > 0.0):
            raise checks.invalid_goal(f"the {name} must be a finite number above 0, not {value:g}")
    step_rad = problem.max_joint_step_rad
    if not (math.isfinite(step_rad) and step_rad >= 0.0):
        raise checks.invalid_goal(f"the greatest joint step must be a finite number of 0 rad or more, not {step_rad:g}")
    if not problem.segments:
        raise checks.invalid_goal("the path has no segment")
    for index, segment in enumerate(problem.segments):
        checks.check_point(segment.end.position_m, f"end of segment {index}")
        checks.check_length(segment.end.orientation, f"quaternion of segment {index}")
        if isinstance(segment, Arc):
            checks.check_point(segment.via_m, f"point on the way of segment {index}")


def check_shape(start_m: Vector, problem: CartesianProblem) -> None:
    """Check that three points make each arc and the path, from the tip's position on, is not too long."""
    length_m = 0.0
    for index, segment in enumerate(problem.segments):
        flaw = arc_flaw(start_m, segment) if isinstance(segment, Arc) else None
        if flaw is not None:
            raise checks.invalid_goal(f"segment {index} is no arc: {flaw}")
        length_m += float(np.linalg.norm(np.asarray(segment.end.position_m) - start_m))
        start_m = np.asarray(segment.end.position_m)
    if length_m > MOST_POINTS * problem.max_step_m:
        text = f"a path of {length_m:.4g} m in steps of {problem.max_step_m:g} m has more than {MOST_POINTS} points"
        raise checks.invalid_goal(text)
