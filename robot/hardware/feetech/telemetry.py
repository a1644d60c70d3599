"""The last good reading of every servo, how old it is, and whom to ask next."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from robot.calibration import RAD_PER_TICK
from robot.hardware.feetech.packets import StatusFrame
from robot.hardware.feetech.registers import Telemetry, parse_telemetry
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.interface import FREE_SPEED_RAD_S, JUMP_RAD, Measured

# A servo that has missed this many reads in a row is asked less often: waiting for it costs half of a period. As many
# as make its reading stale, so that it is not taken for lost because it was not asked.
MISSES_UNTIL_SILENT = 10
ASK_SILENT_EVERY = 10

# Where none speaks, waiting for all of them takes most of a period. The cycles in between have room for sequences: an
# emergency stop must be able to say that nobody confirms it.
ASK_ALL_EVERY = 3


class _Seen(NamedTuple):
    """One servo's last good reading."""

    reading: Telemetry
    status: int


class ServoWatch:
    """Keeps the servos' readings.

    Args:
        servos: the arm's servos.
    """

    def __init__(self, servos: ServoMap) -> None:
        self._servos = servos
        self._seen: dict[int, _Seen] = {}
        self._read_at_s: dict[int, float] = {}
        self._frames: Mapping[int, StatusFrame] = {}
        self._measured: Measured | None = None
        self._cycle = 0
        self._misses_in_row = dict.fromkeys(servos.ids, 0)
        self._doubted: set[int] = set()
        self.silent_cycles = dict.fromkeys(servos.ids, 0)

    @property
    def complete(self) -> bool:
        """Whether every servo has answered at least once."""
        return len(self._seen) == len(self._servos.ids)

    def ids_to_ask(self) -> list[int]:
        """Servos to ask in this cycle: silent ones last, and only now and then."""
        self._cycle += 1
        silent = [servo for servo in self._servos.ids if self.is_silent(servo)]
        speaking = [servo for servo in self._servos.ids if servo not in silent]
        every = ASK_SILENT_EVERY if speaking else ASK_ALL_EVERY
        return speaking if self._cycle % every else speaking + silent

    def is_silent(self, servo_id: int) -> bool:
        """Whether a servo has missed so many reads in a row that it is asked less often."""
        return self._misses_in_row[servo_id] >= MISSES_UNTIL_SILENT

    def take(self, asked: list[int], frames: Mapping[int, StatusFrame], now_s: float) -> None:
        """Keep what one block read brought.

        A reply that tells of a jump no joint can make may be another servo's with a disturbed id: it counts as none
        the first time. Told twice in a row, it is what the servo means.

        Args:
            asked: the servos that were asked.
            frames: the replies that came, each with the telemetry block.
            now_s: monotonic time at which they were asked: no reading is newer than it seems [s].
        """
        if frames is self._frames and len(frames) == len(self._servos.ids) and not self._doubted:
            # The same bytes as in the last cycle, which were believed.
            self._read_at_s = dict.fromkeys(self._servos.ids, now_s)
            return
        self._frames, self._measured = frames, None
        readings = {servo: parse_telemetry(frame.data) for servo, frame in frames.items()}
        jumped = {servo for servo, reading in readings.items() if self._jumps(servo, reading, now_s)}
        believed = readings.keys() - (jumped - self._doubted)
        self._doubted = (self._doubted - frames.keys()) | (jumped - believed)
        for servo in believed:
            self._seen[servo] = _Seen(readings[servo], readings[servo].status | frames[servo].error)
            self._read_at_s[servo] = now_s
            self._misses_in_row[servo] = 0
        for servo in self._servos.ids:
            if servo not in believed:
                self._misses_in_row[servo] += servo in asked
                self.silent_cycles[servo] += 1

    def _jumps(self, servo_id: int, reading: Telemetry, now_s: float) -> bool:
        """Whether a servo cannot have turned from its last reading to this one."""
        seen = self._seen.get(servo_id)
        if seen is None:
            return False
        way_rad = abs(reading.position_ticks - seen.reading.position_ticks) * RAD_PER_TICK
        return way_rad > JUMP_RAD + FREE_SPEED_RAD_S * (now_s - self._read_at_s[servo_id])

    def age_s(self, servo_id: int, now_s: float) -> float:
        """Time since a servo's last good reply [s]; endless when there was none."""
        read_at_s = self._read_at_s.get(servo_id)
        return float("inf") if read_at_s is None else now_s - read_at_s

    def measured(self, now_s: float, stamp_s: float) -> Measured:
        """All readings as arrays; every servo must have answered once."""
        age_s = np.array([now_s - self._read_at_s[servo] for servo in self._servos.ids])
        if self._measured is not None:
            return self._measured._replace(age_s=age_s, stamp_s=stamp_s)
        seen = [self._seen[servo] for servo in self._servos.ids]
        readings = [each.reading for each in seen]
        # From plain numbers: each operation on arrays costs more than all the arithmetic for six joints.
        self._measured = Measured(
            position_rad=np.array(self._servos.positions_rad([reading.position_ticks for reading in readings])),
            velocity_rad_s=np.array(self._servos.velocities_rad_s([reading.velocity_ticks_s for reading in readings])),
            load=np.array([reading.load_permille / 1000.0 for reading in readings]),
            current_a=np.array([reading.current_a for reading in readings]),
            voltage_v=np.array([reading.voltage_v for reading in readings]),
            temperature_c=np.array([float(reading.temperature_c) for reading in readings]),
            status=np.array([each.status for each in seen]),
            age_s=age_s,
            stamp_s=stamp_s,
        )
        return self._measured
