"""The last check of every motion: the timed curve as it will be driven, the samples and the curve between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.geometry.collision import CollidingPair
from planners.geometry.joint_space import JointSpace
from planners.geometry.sweep import FINEST_STEP_M, Cubics, first_contact
from robot.trajectory import Trajectory


@dataclass(frozen=True)
class Contact:
    """Something touches on a motion."""

    time_s: float  # time of the first contact [s]
    # Pairs in contact, deepest first; empty where a condition of the space does not hold.
    pairs: tuple[CollidingPair, ...]


def certify(space: JointSpace, trajectory: Trajectory) -> Contact | None:
    """Return the first contact on a motion, also between its samples, as :meth:`Trajectory.sample` joins them.

    None certifies the motion: no point of it is in contact, or by at most half of :data:`FINEST_STEP_M`. The motion has
    the joints of the space, in the same order.
    """
    time_s = _first_contact_s(space, trajectory)
    # Hulls are wider than links: overlaps of hulls only are checked again by parts. Each turn adds a pair.
    while time_s is not None and space.refine_at(trajectory.sample(time_s)[0]):
        time_s = _first_contact_s(space, trajectory)
    return None if time_s is None else Contact(time_s, space.contacts(trajectory.sample(time_s)[0]))


def _first_contact_s(space: JointSpace, trajectory: Trajectory) -> float | None:
    positions = trajectory.positions_rad
    if not space.free(positions[0]):
        return 0.0
    if len(positions) == 1:
        return None
    curve = cubics(trajectory)
    if curve.straight() and space.line_free(positions[0], positions[-1], FINEST_STEP_M):
        return None
    at = first_contact(space, curve, FINEST_STEP_M)
    if at is not None:
        return float(np.interp(at, np.arange(len(positions)), trajectory.time_s))
    return None if space.free(positions[-1]) else trajectory.duration_s


def cubics(trajectory: Trajectory) -> Cubics:
    """The curve that the samples describe."""
    third_s = np.diff(trajectory.time_s)[:, np.newaxis] / 3.0
    start, end = trajectory.positions_rad[:-1], trajectory.positions_rad[1:]
    leaving = start + third_s * trajectory.velocities_rad_s[:-1]
    arriving = end - third_s * trajectory.velocities_rad_s[1:]
    return Cubics(np.stack((start, leaving, arriving, end), axis=1))
