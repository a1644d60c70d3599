"""The last check of every motion: the timed curve as it will be driven, samples and all that is between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.geometry.collision import Closeness, CollidingPair
from planners.geometry.joint_space import JointSpace
from planners.geometry.sweep import FINEST_STEP_M, Cubics, first_contact
from robot.trajectory import Trajectory


@dataclass(frozen=True)
class Contact:
    """Something touches on a motion.

    Attributes:
        time_s: when, the first time [s].
        pairs: what, deepest first; empty where not a contact but a condition of the space is in the way.
    """

    time_s: float
    pairs: tuple[CollidingPair, ...]


def certify(space: JointSpace, trajectory: Trajectory, closest: Closeness = Closeness.SURFACES) -> Contact | None:
    """Make sure that nothing touches on a motion, also between its samples, as :meth:`Trajectory.sample` joins them.

    Args:
        space: the joints of the motion in their order, and what they must not touch.
        trajectory: the motion.
        closest: the closest shapes that may excuse a contact of the hulls.

    Returns:
        The first contact, or None: then no point between two samples is in contact, or by at most half of
        :data:`FINEST_STEP_M`.
    """
    time_s = _first_contact_s(space, trajectory)
    # Hulls are wider than links: where only they touch, what they enclose has the last word. Each turn adds a pair.
    while time_s is not None and space.look_closer_at(trajectory.sample(time_s)[0], closest):
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
    at = first_contact(space, curve, FINEST_STEP_M, earliest=True)
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
