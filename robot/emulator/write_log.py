"""Log of every write to the servos, for checks of the host from the servos' side."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from scservo_sdk import INST_ACTION, INST_SYNC_WRITE, INST_WRITE

from robot.emulator.servo import EmulatedServo

_NAMES: Mapping[int, str] = MappingProxyType(
    {INST_WRITE: "write", INST_SYNC_WRITE: "sync_write", INST_ACTION: "action"}
)


class WriteLog:
    """Log file with one JSON line for each write instruction or live command, flushed at once.

    ============== ===========================================================================
    ``t``           time of the bus: of the control loop it runs in, or the machine's monotonic clock [s]
    ``machine_t``   the machine's monotonic clock, the same in every process [s]
    ``instruction`` "write", "sync_write", "action" (of kept writes), or "command"
    ``address``     first register written; null for a command
    ``data``        servo id to the bytes written; empty for a command
    ``registers``   servo id to the registers wholly written by these bytes, name to value
    ``command``     the live command; for a command only
    ``present``     servo id to PRESENT_POSITION [ticks]
    ``torque``      servo id to TORQUE_ENABLE
    ``goal``        servo id to GOAL_POSITION [ticks]
    ``limit``       servo id to its torque limit [0.1 %]
    ``status``      servo id to its error bits, register STATUS
    ============== ===========================================================================

    The last five are of all servos, after the write.

    Raises:
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path, *, append: bool = False) -> None:
        self._file = path.open("a" if append else "w", buffering=1)

    def record_write(
        self, now_s: float, code: int, address: int, data: Mapping[int, bytes], servos: Sequence[EmulatedServo[Any]]
    ) -> None:
        """Append the line of a write."""
        memory = servos[0].memory
        what = {
            "instruction": _NAMES[code],
            "address": address,
            "data": {servo_id: list(values) for servo_id, values in data.items()},
            "registers": {
                servo_id: {register.name: value for register, value in memory.decode_block(address, values).items()}
                for servo_id, values in data.items()
            },
        }
        self._append(now_s, what, servos)

    def record_command(self, now_s: float, command: Mapping[str, object], servos: Sequence[EmulatedServo[Any]]) -> None:
        """Append the line of a live command."""
        self._append(now_s, {"instruction": "command", "address": None, "data": {}, "command": command}, servos)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _append(self, now_s: float, what: Mapping[str, object], servos: Sequence[EmulatedServo[Any]]) -> None:
        line = {
            "t": now_s,
            "machine_t": time.monotonic(),
            **what,
            "present": {servo.servo_id: servo.present_ticks for servo in servos},
            "torque": {servo.servo_id: servo.named("TORQUE_ENABLE") for servo in servos},
            "goal": {servo.servo_id: servo.named("GOAL_POSITION") for servo in servos},
            "limit": {servo.servo_id: servo.torque_limit_permille for servo in servos},
            "status": {servo.servo_id: servo.error for servo in servos},
        }
        self._file.write(json.dumps(line) + "\n")
