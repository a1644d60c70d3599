"""Control cycle of the arm: read, update, write, as in ros2_control's controller manager."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

from robot.advice import ServoAlert
from robot.control.controller import ArmController
from robot.faults import Fault, FaultCode
from robot.hardware.interface import HardwareInterface, Measured, status_names
from robot.messages import MotionEnded
from robot.trajectory import Vector

# A register check repeats what it finds, about once a second, until the servo is driven again.
SAME_ERROR_S = 5.0

# Findings of register checks that are counted.
_FOUND = {
    FaultCode.SERVO_REBOOTED: ServoAlert.SERVO_REBOOTED,
    FaultCode.TORQUE_LOST: ServoAlert.TORQUE_LOST,
}


class ErrorCounts:
    """Errors of one arm's actuators.

    Status flags count each time they come up; a servo that was found rebooted or relaxed counts once until it is sound
    again.
    """

    def __init__(self, joint_names: Sequence[str]) -> None:
        self._joints = {name: joint for joint, name in enumerate(joint_names)}
        self._counts: list[Counter[str]] = [Counter() for _ in joint_names]
        self._status = [0] * len(joint_names)
        self._found_s: dict[str, float] = {}

    def observe(self, measured: Measured) -> None:
        """Count the status flags that have come up since the last readings."""
        status = measured.status.tolist()
        if status == self._status:
            return
        for joint, (word, before) in enumerate(zip(status, self._status, strict=True)):
            self._counts[joint].update(status_names(word & ~before))
        self._status = status

    def add_finding(self, fault: Fault, now_s: float) -> None:
        """Count what a register check has found."""
        alert, joint = _FOUND.get(fault.code), self._joints.get(fault.joint)
        if alert is None or joint is None:
            return
        last_s = self._found_s.get(fault.joint)
        if last_s is None or now_s - last_s > SAME_ERROR_S:
            self._counts[joint][alert.value] += 1
        self._found_s[fault.joint] = now_s

    def of(self, joint: int) -> Mapping[str, int]:
        """Return the counts of the joint at an index of the arrays, by kind."""
        return dict(self._counts[joint])


class ControlCycle:
    """Control cycle on open hardware."""

    def __init__(self, hardware: HardwareInterface, clock: Callable[[], float]) -> None:
        self.hardware = hardware
        self.controller: ArmController | None = None  # None until the actuators were surveyed
        self.measured: Measured | None = None  # latest readings; None until every joint has answered
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
