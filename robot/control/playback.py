"""Playing a trajectory: where the arm should be now, and how to stop on the way without leaving the path."""

from __future__ import annotations

import numpy as np

from robot.trajectory import Trajectory, Vector

# While a joint already uses all of its acceleration on the path, braking may add this share of the limit.
BRAKING_SHARE = 0.5

# Change of the rate [1/s] where nothing moves, at the ends of a motion: stops within one tick.
STANDSTILL_BRAKING = 1e3

# Below this rate the rest of the stop is shorter than one tick.
STOPPED_RATE = 1e-3


class Playback:
    """One trajectory being played.

    The path time ``s`` runs at ``rate`` seconds a second: 1 while playing, ramped down to 0 to stop, in between for a
    slower motion. With q(s) the path, the joints feel the velocity rate * q'(s) and the acceleration
    rate^2 * q''(s) + d(rate)/dt * q'(s).

    Attributes:
        ceiling: the rate at which to play, in (0, 1].

    Args:
        trajectory: the motion.
        max_acceleration: of each of its joints, shape (joints,) [rad/s^2].
    """

    def __init__(self, trajectory: Trajectory, max_acceleration: Vector) -> None:
        self.trajectory = trajectory
        self._max_acceleration = max_acceleration
        self._path_time_s = 0.0
        self._rate = 1.0
        self._stopping = False
        self.ceiling = 1.0

    @property
    def stopping(self) -> bool:
        """Whether a stop was asked for."""
        return self._stopping

    @property
    def finished(self) -> bool:
        """Whether the goal no longer moves: the end is reached, or the stop is complete."""
        return self._rate == 0.0 or self._path_time_s >= self.trajectory.duration_s

    @property
    def completed(self) -> bool:
        """Whether the end of the trajectory was reached."""
        return self._path_time_s >= self.trajectory.duration_s

    @property
    def fraction(self) -> float:
        """Share of the duration that is done, 0..1."""
        duration_s = self.trajectory.duration_s
        return min(self._path_time_s / duration_s, 1.0) if duration_s > 0.0 else 1.0

    @property
    def remaining_s(self) -> float:
        """Time to the end at the rate allowed now [s]."""
        return max(self.trajectory.duration_s - self._path_time_s, 0.0) / self.ceiling

    def stop(self) -> None:
        """Begin to brake along the path."""
        self._stopping = True

    def advance(self, elapsed_s: float) -> Vector:
        """Move on by a time and return the goal there, shape (joints,) [rad]."""
        target = 0.0 if self._stopping else self.ceiling
        if self._rate != target:
            change = self._largest_change() * elapsed_s
            self._rate = max(target, self._rate - change) if self._rate > target else min(target, self._rate + change)
            if self._stopping and self._rate < STOPPED_RATE:
                self._rate = 0.0
        self._path_time_s = min(self._path_time_s + self._rate * elapsed_s, self.trajectory.duration_s)
        return self.trajectory.sample(self._path_time_s)[0]

    def _largest_change(self) -> float:
        """Fastest allowed change of the rate [1/s]: what no joint's acceleration limit forbids."""
        _, velocity, acceleration = self.trajectory.sample(self._path_time_s)
        speed = np.abs(velocity)
        in_use = self._rate**2 * np.abs(acceleration)
        spare = np.maximum(self._max_acceleration - in_use, BRAKING_SHARE * self._max_acceleration)
        moving = speed > 1e-6
        if not moving.any():
            return STANDSTILL_BRAKING
        return float(np.min(spare[moving] / speed[moving]))
