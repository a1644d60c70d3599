"""A record of every write that the servos took, for checks that look at the driver from the servos' side."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from robot.emulator.servo import Servo
from robot.registers import Register


class WriteLog:
    """One JSON line per write instruction, flushed at once.

    Each line has ``t`` (monotonic clock [s]), ``instruction`` ("write" or "sync_write"), ``address``,
    ``data`` (servo id to bytes), and of all servos after the write ``present`` (ticks) and ``torque``
    (register TORQUE_ENABLE).
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", buffering=1)

    def record(
        self, now_s: float, instruction: str, address: int, data: Mapping[int, bytes], servos: Sequence[Servo]
    ) -> None:
        """Append one line."""
        line = {
            "t": now_s,
            "instruction": instruction,
            "address": address,
            "data": {servo_id: list(values) for servo_id, values in data.items()},
            "present": {servo.servo_id: servo.present_ticks for servo in servos},
            "torque": {servo.servo_id: servo.value(Register.TORQUE_ENABLE) for servo in servos},
        }
        self._file.write(json.dumps(line) + "\n")

    def close(self) -> None:
        """Close the file."""
        self._file.close()
