"""Comparison of driven servos' registers with what was written to them.

A servo whose supply dips reboots, with torque off and its torque limit at the maximum. A servo that its watchdog has
stopped ignores its goals. Telemetry shows neither, so the registers of one servo at a time are read back, in turn.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import Any

from robot.faults import Fault, FaultCode
from robot.hardware.servos.family import Limit, ServoFamily, ServoFound, Values
from robot.hardware.servos.registers import Block
from robot.hardware.servos.servo_map import ServoMap

# Cycles between register checks: each of six servos is checked about once a second.
CYCLES_BETWEEN = 16


class RegisterChecks:
    """Register checks of an arm's servos, which are surveyed later."""

    def __init__(self, family: ServoFamily, servos: ServoMap, found: Mapping[int, ServoFound]) -> None:
        self._family = family
        self._servos = servos
        self._found = found
        self._turn = cycle((servo, block) for block in family.read_back for servo in servos.ids)
        self._cycle = 0
        self._expected: dict[int, Limit] = {}
        self.torque_on: dict[int, bool] = {}

    def due(self) -> tuple[int, Block[Any]] | None:
        """Return the servo and the block to read back in this cycle, if any."""
        self._cycle += 1
        return None if self._cycle % CYCLES_BETWEEN else next(self._turn)

    def expect(self, limits: Mapping[int, Limit]) -> None:
        """Expect these torque limits, which were written to the servos, by id."""
        self._expected = dict(limits)
        self.torque_on.clear()

    def limits_to_write(self, limits: Mapping[int, Limit]) -> dict[int, Limit]:
        """Return the torque limits that differ from the expected ones, and expect them, by id."""
        if limits == self._expected:
            return {}
        changed = {servo: limit for servo, limit in limits.items() if self._expected.get(servo) != limit}
        self._expected.update(changed)
        return changed

    def check(self, servo_id: int, values: Values, stamp_s: float) -> Fault | None:
        """Compare registers of a driven servo with what was written to it.

        Return the fault, at a wall-clock time [s since the epoch], of a servo that has rebooted, was relaxed, or was
        stopped by its watchdog.
        """
        limit, joint = self._expected.get(servo_id), self._servos.by_id[servo_id].joint
        torque_on = values.get(self._family.registers.torque_enable)
        if torque_on is not None:
            self.torque_on[servo_id] = torque_on == 1
        if limit is not None:
            watchdog = self._family.watchdog
            if watchdog is not None and values.get(watchdog.register) == watchdog.tripped:
                silence = f"{watchdog.silence_s:g} s"
                message = f"the servo of joint {joint} has stopped by itself, since it heard nothing for {silence}"
                return Fault(FaultCode.SERVO_SILENT, message, joint, stamp_s)
            restarted = self._family.has_restarted(self._found[servo_id], values, limit)
            if restarted or values.get(limit.register, limit.value) != limit.value:
                self._expected.pop(servo_id)
            if restarted:
                return Fault(FaultCode.SERVO_REBOOTED, f"the servo of joint {joint} has restarted", joint, stamp_s)
        if torque_on not in (None, 1):
            return Fault(FaultCode.TORQUE_LOST, f"the servo of joint {joint} was found relaxed", joint, stamp_s)
        return None
