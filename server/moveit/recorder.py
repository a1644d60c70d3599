"""Notes where the arm is while a motion runs."""

from __future__ import annotations

import numpy as np

from robot.messages import ArmState
from robot.trajectory import Trajectory

# Ten minutes at 50 Hz; of a longer motion the beginning is kept.
MAX_SAMPLES = 30_000


class Recorder:
    """The readings since the last :meth:`start`."""

    def __init__(self) -> None:
        self._states: list[ArmState] | None = None

    def start(self) -> None:
        """Begin anew."""
        self._states = []

    def take_state(self, state: ArmState) -> None:
        """Note a state of the arm, while a motion is being recorded."""
        if self._states is None or state.position_rad is None or state.velocity_rad_s is None:
            return
        if len(self._states) < MAX_SAMPLES and (not self._states or state.stamp_s > self._states[-1].stamp_s):
            self._states.append(state)

    def finish(self, joint_names: tuple[str, ...]) -> Trajectory | None:
        """End the recording; returns the way of these joints, or None when nothing was read.

        The servos measure no accelerations: those are 0.
        """
        states, self._states = self._states, None
        if not states:
            return None
        columns = [states[0].joint_names.index(name) for name in joint_names]
        time_s = np.array([state.stamp_s for state in states]) - states[0].stamp_s
        positions_rad = np.array([state.position_rad for state in states])[:, columns]
        velocities_rad_s = np.array([state.velocity_rad_s for state in states])[:, columns]
        return Trajectory(joint_names, time_s, positions_rad, velocities_rad_s, np.zeros_like(positions_rad))
