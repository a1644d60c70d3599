"""What the tip should do now: the command, and what brings back what drifted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.world import placement
from planners.scene import Point, Pose
from planners.servo.question import Anchor, ServoLimits, TipTarget, TipTwist

Vector = NDArray[np.float64]

# An error shrinks to a third in a quarter of a second: ten times the delay from question to servo.
GAIN_PER_S = 4.0

# Further than this from its anchor the tip is not drifting but held off, by a limit or by what is in the way; the
# anchor then comes along.
MAX_DRIFT_M = 0.02
MAX_DRIFT_RAD = 0.35

# While it is held off it is pulled no more than keeps it from sliding away by itself, at 2 cm/s.
HELD_DRIFT_M = 0.005


@dataclass(frozen=True)
class Wish:
    """What the tip should do, along the root link's axes.

    Attributes:
        linear_m_s: its velocity, shape (3,) [m/s].
        angular_rad_s: its angular velocity, shape (3,) [rad/s].
        drift_rad: how far it is turned from its anchor or target [rad].
        anchor: what to keep from now on; None where there is nothing to keep.
    """

    linear_m_s: Vector
    angular_rad_s: Vector
    drift_rad: float
    anchor: Anchor | None


def steered(command: TipTwist, tip: pin.SE3, anchor: Anchor | None) -> Wish:
    """The wish of a twist: what it does not move is held where it was.

    Args:
        command: the twist.
        tip: where the tip is.
        anchor: what was kept until now; None at the beginning.
    """
    linear, angular = np.array(command.linear_m_s), np.array(command.angular_rad_s)
    along, about = _direction(linear), _direction(angular)
    kept = anchor or Anchor(_pose(tip))
    if command.zero:
        # It still brakes: what it had been moved along it need not come back for.
        along, about = np.array(kept.along), np.array(kept.about)
    # An orientation that cannot be had would keep an arm moving that nobody moves.
    righting_per_s = 0.0 if command.zero else GAIN_PER_S
    at = placement(kept.pose)
    drift = _shortened(_across(at.translation - tip.translation, along), MAX_DRIFT_M)
    turned = _shortened(_across(pin.log3(at.rotation @ tip.rotation.T), about), MAX_DRIFT_RAD)
    place = pin.SE3(pin.exp3(turned) @ tip.rotation, tip.translation + drift)
    return Wish(
        linear + GAIN_PER_S * drift,
        angular + righting_per_s * turned,
        float(np.linalg.norm(turned)),
        Anchor(_pose(place), _point(along), _point(about)),
    )


def loosened(anchor: Anchor, tip: pin.SE3) -> Anchor:
    """The anchor of a tip that is held back: to be pulled to its way would keep it from going where it can.

    Args:
        anchor: what was to be kept.
        tip: where the tip is.
    """
    drift = _shortened(placement(anchor.pose).translation - tip.translation, HELD_DRIFT_M)
    return Anchor(_pose(pin.SE3(tip.rotation, tip.translation + drift)), anchor.along, anchor.about)


def aimed(command: TipTarget, tip: pin.SE3, limits: ServoLimits) -> Wish:
    """The wish of a target: to be there, not faster than allowed."""
    target = placement(command.pose)
    missing_m, missing_rad = target.translation - tip.translation, pin.log3(target.rotation @ tip.rotation.T)
    return Wish(
        _shortened(GAIN_PER_S * missing_m, limits.linear_m_s),
        _shortened(GAIN_PER_S * missing_rad, limits.angular_rad_s),
        float(np.linalg.norm(missing_rad)),
        None,
    )


def _direction(vector: Vector) -> Vector:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0.0 else np.zeros(3)


def _across(vector: Vector, direction: Vector) -> Vector:
    return np.asarray(vector - (vector @ direction) * direction)


def _shortened(vector: Vector, longest: float) -> Vector:
    length = float(np.linalg.norm(vector))
    return vector if length <= longest else vector * (longest / length)


def _pose(place: pin.SE3) -> Pose:
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(place).tolist()
    return Pose((x, y, z), (qx, qy, qz, qw))


def _point(vector: Vector) -> Point:
    x, y, z = vector.tolist()
    return x, y, z
