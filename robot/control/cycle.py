"""One cycle of the arm: read, decide, write, as ros2_control's controller manager does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from robot.control.controller import ArmController
from robot.hardware.interface import HardwareInterface, Measured
from robot.messages import MotionEnded
from robot.trajectory import Vector


class ControlCycle:
    """An arm whose hardware is open.

    Args:
        hardware: the arm's actuators.
        clock: time of the control loop [s].

    Attributes:
        hardware: as given.
        controller: decides on goals; None until the actuators were found.
        measured: the latest readings; None until every joint has been heard.
    """

    def __init__(self, hardware: HardwareInterface, clock: Callable[[], float]) -> None:
        self.hardware = hardware
        self.controller: ArmController | None = None
        self.measured: Measured | None = None
        self._clock = clock
        self._writing = True

    def tick(self) -> list[MotionEnded]:
        """Read the joints, decide, and tell them their goals; returns the motions that this ended.

        Raises:
            PortLost: the port is gone.
        """
        measured = self.hardware.read()
        self.measured = measured
        controller = self.controller
        if controller is None or measured is None:
            return []
        ended = controller.step(measured, self._clock())
        if controller.driven and self._writing:
            self.hardware.write_goals(controller.goal_rad)
            self.hardware.write_torque_shares(controller.torque_limit)
        fault = self.hardware.check(measured.stamp_s)
        if fault is not None and controller.driven:
            ended += controller.react(fault, measured)
        return ended

    def hold(self, goal_rad: Vector) -> None:
        """Note that the joints were told these goals, at full torque; goals far from the arm come back to it.

        Args:
            goal_rad: goals of all joints, shape (joints,) [rad].
        """
        if self.controller is not None:
            self.controller.hold(goal_rad, self.measured)

    @contextmanager
    def writing_paused(self) -> Iterator[None]:
        """Leave the joints to a sequence that tells them goals, while no tick tells them those that they had before."""
        self._writing = False
        try:
            yield
        finally:
            self._writing = True
