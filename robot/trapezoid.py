"""The fastest motion of one joint from rest to rest: full acceleration, full speed, full deceleration."""

from __future__ import annotations

import math

import numpy as np

from robot.trajectory import Trajectory

# Shorter ways are no motion: a servo's tick is a thousand times as much.
SHORTEST_WAY_RAD = 1e-6


def rest_to_rest(
    joint: str, start_rad: float, end_rad: float, max_velocity: float, max_acceleration: float
) -> Trajectory:
    """Plan the motion; its cubic interpolation between the corners is exact.

    Args:
        joint: the joint that moves.
        start_rad: where it rests [rad].
        end_rad: where it is to rest [rad].
        max_velocity: above 0 [rad/s].
        max_acceleration: above 0 [rad/s^2].
    """
    way_rad = abs(end_rad - start_rad)
    if way_rad < SHORTEST_WAY_RAD:
        still = np.zeros((1, 1))
        return Trajectory((joint,), np.zeros(1), np.full((1, 1), end_rad), still, still)
    peak = min(max_velocity, math.sqrt(max_acceleration * way_rad))
    ramp_s = peak / max_acceleration
    cruise_s = way_rad / peak - ramp_s
    ramp_rad = 0.5 * peak * ramp_s
    corners = [
        (0.0, 0.0, 0.0, max_acceleration),
        (ramp_s, ramp_rad, peak, 0.0),
        (ramp_s + cruise_s, way_rad - ramp_rad, peak, -max_acceleration),
        (2.0 * ramp_s + cruise_s, way_rad, 0.0, -max_acceleration),
    ]
    if cruise_s < 1e-3 * ramp_s:
        del corners[1]
    time_s, way, velocity, acceleration = np.array(corners).T
    direction = math.copysign(1.0, end_rad - start_rad)
    return Trajectory(
        (joint,),
        time_s,
        start_rad + direction * way[:, None],
        direction * velocity[:, None],
        direction * acceleration[:, None],
    )
