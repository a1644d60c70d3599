"""Checks that the servos still are as they were told: torque on, and limited as it should be.

A servo whose supply dips starts anew, with torque off and its torque limit at the most; nothing in its telemetry says
so. One servo's control block is read back at a time, so that the bus has room for it.
"""

from __future__ import annotations

from itertools import cycle

from robot.faults import Fault, FaultCode
from robot.hardware.feetech.registers import Control
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.feetech.survey import ServoFound

# Every servo about once a second: six of them, one in every sixteenth cycle.
CYCLES_BETWEEN = 16


class RegisterChecks:
    """Torque limits that the servos were told, beside those that they hold.

    Args:
        servos: the arm's servos.
        found: servos as the survey found them, by id; may be filled later.

    Attributes:
        torque_on: register TORQUE_ENABLE of each servo when it was last read back, by id.
    """

    def __init__(self, servos: ServoMap, found: dict[int, ServoFound]) -> None:
        self._servos = servos
        self._found = found
        self._turn = cycle(servos.ids)
        self._cycle = 0
        self._wanted: dict[int, int] = {}
        self.torque_on: dict[int, bool] = {}

    def due(self) -> int | None:
        """Choose the servo to read back in this cycle, if any."""
        self._cycle += 1
        return None if self._cycle % CYCLES_BETWEEN else next(self._turn)

    def told(self, permille: dict[int, int]) -> None:
        """Note that the servos have been given torque limits [0.1 %]; what they were before is forgotten."""
        self._wanted = dict(permille)
        self.torque_on.clear()

    def limits_to_write(self, permille: dict[int, int]) -> dict[int, int]:
        """Choose those of the wanted torque limits that the servos were not told yet [0.1 %]."""
        if permille == self._wanted:
            return {}
        changed = {servo: limit for servo, limit in permille.items() if self._wanted.get(servo) != limit}
        self._wanted.update(changed)
        return changed

    def judge(self, servo_id: int, control: Control, stamp_s: float) -> Fault | None:
        """Compare what a driven servo holds with what it was told.

        Args:
            servo_id: the servo.
            control: its control block.
            stamp_s: wall-clock time [s since the epoch].
        """
        self.torque_on[servo_id] = control.torque_on
        wanted = self._wanted.get(servo_id)
        if wanted != control.torque_limit_permille:
            self._wanted.pop(servo_id, None)
        fresh = self._found[servo_id].max_torque_permille
        rebooted = control.torque_limit_permille == fresh != wanted
        joint = self._servos.by_id[servo_id].joint
        if rebooted and wanted is not None:
            return Fault(FaultCode.SERVO_REBOOTED, f"the servo of joint {joint} has started anew", joint, stamp_s)
        if not control.torque_on:
            return Fault(FaultCode.TORQUE_LOST, f"the servo of joint {joint} was found relaxed", joint, stamp_s)
        return None
