"""Control cycle of the arm: read, update, write, as in ros2_control's controller manager."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from robot.control.controller import ArmController
from robot.control.error_counts import ErrorCounts
from robot.hardware.interface import HardwareInterface, Measured
from robot.messages import MotionEnded
from robot.trajectory import Vector


class ControlCycle:
    """Control cycle on open hardware.

    Attributes:
        controller: controller of the arm; None until the actuators were surveyed.
        measured: latest readings; None until every joint has answered.
    """

    def __init__(self, hardware: HardwareInterface, clock: Callable[[], float]) -> None:
        self.hardware = hardware
        self.controller: ArmController | None = None
        self.measured: Measured | None = None
        self.errors = ErrorCounts(hardware.joint_names)
        self._clock = clock
        self._writing = True

    def tick(self) -> list[MotionEnded]:
        """Read the joints, update the controller, and write the goals; return the ends of motions."""
        measured = self.hardware.read()
        self.measured = measured
        controller = self.controller
        if measured is not None:
            self.errors.observe(measured)
        if controller is None or measured is None:
            return []
        ended = controller.step(measured, self._clock())
        if controller.torque_enabled and self._writing:
            self.hardware.write_goals(controller.goal_rad)
            self.hardware.write_torque_shares(controller.torque_limit)
        fault = self.hardware.check(measured.stamp_s)
        if fault is not None and controller.torque_enabled:
            self.errors.add_finding(fault, self._clock())
            ended += controller.react(fault, measured)
        return ended

    def hold(self, goal_rad: Vector) -> None:
        """Let the controller hold at goals that were written at full torque; goals far from the arm return to it."""
        if self.controller is not None:
            self.controller.hold(goal_rad, self.measured)

    @contextmanager
    def writing_paused(self) -> Iterator[None]:
        """Suspend the ticks' writes while a sequence writes goals of its own."""
        self._writing = False
        try:
            yield
        finally:
            self._writing = True
