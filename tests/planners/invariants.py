"""Invariants of every motion, for any request, and refusals of requests as values."""

from collections.abc import Callable
from typing import Any

import numpy as np

from planners.geometry.collision import DEPTH_ACCURACY_M
from planners.problem import PlanningError, PlanningFailure

# Either of the two lines from the first point to the second runs through the arm's own base.
BLOCKED_LINES = (
    ((1.64, 1.4, 0.63, 0.82, 1.76), (0.96, -0.84, 1.4, 0.62, -2.17)),
    ((1.59, -0.24, 1.44, 0.39, -1.19), (0.19, 1.53, 0.69, 0.55, -2.51)),
)


def never():
    return False


def sampled(trajectory, times_s):
    """Positions, velocities and accelerations at times, shape (m, joints) each."""
    i = np.clip(np.searchsorted(trajectory.time_s, times_s, side="right") - 1, 0, len(trajectory.time_s) - 2)
    span_s = np.diff(trajectory.time_s)[i, None]
    u = (times_s - trajectory.time_s[i])[:, None] / span_s
    p0, m0, m1 = trajectory.positions_rad[i], *(trajectory.velocities_rad_s[j] * span_s for j in (i, i + 1))
    way = trajectory.positions_rad[i + 1] - p0
    c2, c3 = 3.0 * way - 2.0 * m0 - m1, m0 + m1 - 2.0 * way
    positions = p0 + u * (m0 + u * (c2 + u * c3))
    return positions, (m0 + u * (2.0 * c2 + 3.0 * u * c3)) / span_s, (2.0 * c2 + 6.0 * u * c3) / span_s**2


def fine_samples(trajectory, per_interval=4):
    """Positions, velocities and accelerations between the samples, shape (m, joints) each."""
    shares = np.linspace(0.0, 1.0, per_interval, endpoint=False)
    return sampled(trajectory, (trajectory.time_s[:-1, None] + np.diff(trajectory.time_s)[:, None] * shares).ravel())


def assert_well_formed(trajectory):
    shape = (len(trajectory.time_s), len(trajectory.joint_names))
    assert trajectory.time_s[0] == 0.0
    assert np.all(np.diff(trajectory.time_s) > 0.0)
    for part in (trajectory.positions_rad, trajectory.velocities_rad_s, trajectory.accelerations_rad_s2):
        assert part.shape == shape
        assert np.all(np.isfinite(part))


def assert_from_rest_to_rest(trajectory, start, goal):
    np.testing.assert_array_equal(trajectory.positions_rad[0], start)
    np.testing.assert_array_equal(trajectory.positions_rad[-1], goal)
    assert not trajectory.velocities_rad_s[[0, -1]].any()


def assert_keeps_rates(trajectory, limits, excess=1e-6):
    if trajectory.duration_s == 0.0:
        return
    _, velocities, accelerations = fine_samples(trajectory)
    assert np.max(np.abs(velocities) / limits.velocity_rad_s) <= 1.0 + excess
    assert np.max(np.abs(accelerations) / limits.acceleration_rad_s2) <= 1.0 + excess


def least_time_of_line_s(way_rad, limits):
    """Least time from rest to rest along a straight line."""
    share = np.maximum(np.abs(way_rad), 1e-9)
    # Joints keep to the line, so the tightest velocity and acceleration may be those of different joints.
    velocity, acceleration = np.min(limits.velocity_rad_s / share), np.min(limits.acceleration_rad_s2 / share)
    if velocity**2 > acceleration:
        return 2.0 * np.sqrt(1.0 / acceleration)
    return 1.0 / velocity + velocity / acceleration


def assert_keeps_positions(trajectory, lower_rad, upper_rad):
    assert np.all(trajectory.positions_rad >= lower_rad)
    assert np.all(trajectory.positions_rad <= upper_rad)


def configurations(trajectory, collision, start_rad, step_m=0.002):
    """Configurations of all joints along a motion, no robot point moving more than ``step_m`` between them."""
    q = np.array([start_rad[name] for name in collision.joint_names])
    columns = [collision.joint_names.index(name) for name in trajectory.joint_names]
    speed = np.abs(trajectory.velocities_rad_s).max(axis=0, initial=0.0) @ collision.travel_m_per_rad[columns]
    points = trajectory.positions_rad
    if len(points) > 1:
        count = 2 + int(speed * trajectory.duration_s / step_m)
        points, _, _ = sampled(trajectory, np.linspace(0.0, trajectory.duration_s, count))
    for point in points:
        q[columns] = point
        yield q.copy()


def assert_touches_nothing(trajectory, collision, start_rad):
    """No links overlap along a motion, by the closest shapes; those that do at its start do so no deeper."""
    start_m = collision.overlaps_m(np.array([start_rad[name] for name in collision.joint_names]))
    for q in configurations(trajectory, collision, start_rad):
        # Hulls enclose everything, so that the closest shapes are asked only where hulls touch.
        overlaps_m = collision.overlaps_m(q) if collision.in_collision(q) else {}
        for names, overlap_m in overlaps_m.items():
            assert overlap_m <= start_m.get(names, 0.0) + DEPTH_ACCURACY_M, f"{sorted(names)} overlap at {q}"


def refusal(check: Callable[..., Any], *arguments: Any, **named: Any) -> PlanningFailure | None:
    """Return the failure that a check raises, None where it raises none."""
    try:
        check(*arguments, **named)
    except PlanningError as error:
        return error.failure
    return None
