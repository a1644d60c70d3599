"""The last good reading of every servo, how old it is, and whom to ask next."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robot.calibration import RAD_PER_TICK
from robot.servos.packets import StatusFrame
from robot.servos.registers import Telemetry, parse_telemetry
from robot.servos.servo_map import ServoMap
from robot.trajectory import Vector

# A servo that has missed this many reads in a row is asked less often: waiting for it costs half of a period. As many
# as make its reading stale, so that it is not taken for lost because it was not asked.
MISSES_UNTIL_SILENT = 10
ASK_SILENT_EVERY = 10

# Where none speaks, waiting for all of them takes most of a period. The cycles in between have room for sequences: an
# emergency stop must be able to say that nobody confirms it.
ASK_ALL_EVERY = 3

# No servo turns by so much in a cycle: its free speed at 7.4 V is 5.5 rad/s. Longer gaps allow for that speed.
JUMP_RAD = 300 * RAD_PER_TICK
FREE_SPEED_RAD_S = 5.5


class Measured(NamedTuple):
    """The last good reading of every joint, each of shape (joints,).

    Attributes:
        position_rad: [rad].
        velocity_rad_s: [rad/s].
        load: share of full motor duty, signed.
        current_a: motor current, signed [A].
        voltage_v: supply [V].
        temperature_c: of the motors [degC].
        status: bits of ``StatusBit``.
        age_s: how old the readings are [s].
        stamp_s: wall-clock time of the tick [s since the epoch], one number.
    """

    position_rad: Vector
    velocity_rad_s: Vector
    load: Vector
    current_a: Vector
    voltage_v: Vector
    temperature_c: Vector
    status: NDArray[np.int_]
    age_s: Vector
    stamp_s: float = 0.0


class _Seen(NamedTuple):
    """One servo's last good reading."""

    reading: Telemetry
    status: int
    read_at_s: float


class ServoWatch:
    """Keeps the servos' readings.

    Args:
        servos: the arm's servos.
    """

    def __init__(self, servos: ServoMap) -> None:
        self._servos = servos
        self._seen: dict[int, _Seen] = {}
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
        readings = {servo: parse_telemetry(frame.data) for servo, frame in frames.items()}
        jumped = {servo for servo, reading in readings.items() if self._jumps(servo, reading, now_s)}
        believed = readings.keys() - (jumped - self._doubted)
        self._doubted = (self._doubted - frames.keys()) | (jumped - believed)
        for servo in believed:
            self._seen[servo] = _Seen(readings[servo], readings[servo].status | frames[servo].error, now_s)
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
        return way_rad > JUMP_RAD + FREE_SPEED_RAD_S * (now_s - seen.read_at_s)

    def reading(self, servo_id: int) -> Telemetry:
        """The last good reading of a servo that has answered."""
        return self._seen[servo_id].reading

    def status(self, servo_id: int) -> int:
        """The bits of ``StatusBit`` that a servo last complained of."""
        return self._seen[servo_id].status

    def age_s(self, servo_id: int, now_s: float) -> float:
        """Time since a servo's last good reply [s]; endless when there was none."""
        seen = self._seen.get(servo_id)
        return float("inf") if seen is None else now_s - seen.read_at_s

    def measured(self, now_s: float, stamp_s: float) -> Measured:
        """All readings as arrays; every servo must have answered once."""
        seen = [self._seen[servo] for servo in self._servos.ids]
        readings = [each.reading for each in seen]
        # From plain numbers: each operation on arrays costs more than all the arithmetic for six joints.
        return Measured(
            position_rad=np.array(self._servos.positions_rad([reading.position_ticks for reading in readings])),
            velocity_rad_s=np.array(self._servos.velocities_rad_s([reading.velocity_ticks_s for reading in readings])),
            load=np.array([reading.load_permille / 1000.0 for reading in readings]),
            current_a=np.array([reading.current_a for reading in readings]),
            voltage_v=np.array([reading.voltage_v for reading in readings]),
            temperature_c=np.array([float(reading.temperature_c) for reading in readings]),
            status=np.array([each.status for each in seen]),
            age_s=np.array([now_s - each.read_at_s for each in seen]),
            stamp_s=stamp_s,
        )
