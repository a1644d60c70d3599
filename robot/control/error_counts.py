"""Counters of the errors of each joint's actuator, by kind, since the hardware was opened."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from robot.advice import ServoAlert
from robot.faults import Fault, FaultCode
from robot.hardware.interface import Measured, status_names

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
