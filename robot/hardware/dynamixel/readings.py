"""Readings of the servos, their ages, and the servos to read next.

A servo that does not answer must not hold up the others, nor silence them: one that has just missed its turn is asked
last, since servos are said to wait for the reply before theirs, and one that stays silent is asked now and then.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from robot.calibration import RAD_PER_TICK
from robot.hardware.dynamixel.packets import ALERT, StatusFrame
from robot.hardware.dynamixel.registers import AMPERE_PER_UNIT, Climate, Motion, parse_climate, parse_motion, status_of
from robot.hardware.dynamixel.servo_map import ServoMap
from robot.hardware.interface import FREE_SPEED_RAD_S, JUMP_RAD, Measured

# Misses in a row after which a servo is asked behind the others.
MISSES_UNTIL_LAST = 2

# Reads in a row without any reply, for each servo, after which all count as silent: each has been the first once.
EMPTY_READS_PER_SERVO = MISSES_UNTIL_LAST

# A servo that has missed this many reads in a row is read less often: waiting for it costs half of a period. As many as
# make its reading stale, so that it never counts as lost because it was not read.
MISSES_UNTIL_SILENT = 10
ASK_SILENT_EVERY = 10

# When none replies, waiting for all of them takes most of a period. The cycles in between leave time for sequences: an
# emergency stop must be able to report that no servo confirms it.
ASK_ALL_EVERY = 3


class ServoWatch:
    """Readings of the servos, their ages, and the servos to read next.

    Args:
        servos: servos of the arm.

    Attributes:
        silent_cycles: cycles without a reading, by servo id.
    """

    def __init__(self, servos: ServoMap) -> None:
        self._servos = servos
        self._seen: dict[int, _Seen] = {}
        self._climate: dict[int, Climate] = {}
        self._hardware_error: dict[int, int] = {}
        self._error_known: set[int] = set()
        self._read_at_s: dict[int, float] = {}
        self._frames: Mapping[int, StatusFrame] = {}
        self._measured: Measured | None = None
        self._cycle = 0
        self._misses_in_row = dict.fromkeys(servos.ids, 0)
        self._empty_reads = 0
        self._doubted: set[int] = set()
        self.silent_cycles = dict.fromkeys(servos.ids, 0)

    @property
    def complete(self) -> bool:
        """True when every servo has answered at least once, with its supply and temperature."""
        return len(self._seen) == len(self._climate) == len(self._servos.ids)

    def ids_to_ask(self) -> list[int]:
        """Choose the servos to read in this cycle: those that have missed their turn last, silent ones now and then."""
        self._cycle += 1
        misses = self._misses_in_row
        silent = [servo for servo in self._servos.ids if self.is_silent(servo)]
        late = [servo for servo in self._servos.ids if MISSES_UNTIL_LAST <= misses[servo] < MISSES_UNTIL_SILENT]
        speaking = [servo for servo in self._servos.ids if misses[servo] < MISSES_UNTIL_LAST] + late
        every = ASK_SILENT_EVERY if speaking else ASK_ALL_EVERY
        return speaking if self._cycle % every else speaking + silent

    def is_silent(self, servo_id: int) -> bool:
        """Return True for a servo that has missed so many reads in a row that it is read less often."""
        return self._misses_in_row[servo_id] >= MISSES_UNTIL_SILENT

    def alerting(self) -> list[int]:
        """Return the servos that report a hardware error which has not been read lately."""
        return [servo for servo, seen in self._seen.items() if seen.alert and servo not in self._error_known]

    def take_hardware_error(self, servo_id: int, value: int) -> None:
        """Take register HARDWARE_ERROR_STATUS of a servo, which counts until the servo reports none."""
        self._hardware_error[servo_id] = value
        self._error_known.add(servo_id)
        self._measured = None

    def turns_ticks(self, servo_id: int) -> int:
        """Return the whole turns to add to a servo's positions for the calibrated ones, at its latest reading."""
        seen = self._seen.get(servo_id)
        return 0 if seen is None else seen.turns_ticks

    def take(self, asked: Sequence[int], frames: Mapping[int, StatusFrame], now_s: float) -> None:
        """Take the replies to one block read.

        A reading with a jump that no joint can make may be another servo's with a disturbed id: the first one is
        ignored, a second one in a row is believed. When all servos behind a missing one are missing too, they may have
        waited for it, so that it alone has missed its turn.

        Args:
            asked: servos that were asked, in this order.
            frames: valid replies, each with a block of measurements.
            now_s: monotonic time at which they were asked, so that no reading is older than its age [s].
        """
        if frames is self._frames and len(frames) == len(self._servos.ids) and not self._doubted:
            # The same bytes as in the last cycle, whose readings were believed.
            self._read_at_s = dict.fromkeys(self._servos.ids, now_s)
            return
        self._frames, self._measured = frames, None
        readings = {servo: self._seen_in(frame) for servo, frame in frames.items()}
        jumped = {servo for servo, seen in readings.items() if self._jumps(servo, seen, now_s)}
        believed = readings.keys() - (jumped - self._doubted)
        self._doubted = (self._doubted - frames.keys()) | (jumped - believed)
        for servo in believed:
            self._believe(servo, readings[servo], frames[servo], now_s)
        missing = [servo for servo in asked if servo not in frames]
        behind_first = missing[1:] if missing and list(asked[-len(missing) :]) == missing else []
        for servo in self._servos.ids:
            if servo not in believed:
                self._misses_in_row[servo] += servo in asked and servo not in behind_first
                self.silent_cycles[servo] += 1
        self._empty_reads = 0 if frames else self._empty_reads + 1
        if self._empty_reads >= EMPTY_READS_PER_SERVO * len(self._servos.ids):
            for servo, misses in self._misses_in_row.items():
                self._misses_in_row[servo] = max(misses, MISSES_UNTIL_SILENT)

    def age_s(self, servo_id: int, now_s: float) -> float:
        """Return the time since a servo's last good reply [s]; infinite when there was none."""
        read_at_s = self._read_at_s.get(servo_id)
        return float("inf") if read_at_s is None else now_s - read_at_s

    def measured(self, now_s: float, stamp_s: float) -> Measured:
        """Return all readings as arrays; they must be :attr:`complete`."""
        servos, ids = self._servos, self._servos.ids
        age_s = np.array([now_s - self._read_at_s[servo] for servo in ids])
        if self._measured is not None:
            return self._measured._replace(age_s=age_s, stamp_s=stamp_s)
        motions = [self._seen[servo].motion for servo in ids]
        climates = [self._climate[servo] for servo in ids]
        # From plain numbers: an operation on arrays costs more than all the arithmetic for six joints.
        self._measured = Measured(
            position_rad=np.array(servos.positions_rad([self._seen[servo].ticks for servo in ids])),
            velocity_rad_s=np.array(servos.velocities_rad_s([motion.velocity for motion in motions])),
            load=np.array(servos.loads([motion.pwm for motion in motions])),
            current_a=np.array(
                servos.currents_a([self._current_a(servo, motion) for servo, motion in zip(ids, motions, strict=True)])
            ),
            voltage_v=np.array([climate.voltage_v for climate in climates]),
            temperature_c=np.array([float(climate.temperature_c) for climate in climates]),
            status=np.array([int(status_of(self._hardware_error.get(servo, 0))) for servo in ids]),
            age_s=age_s,
            stamp_s=stamp_s,
        )
        return self._measured

    def _seen_in(self, frame: StatusFrame) -> _Seen:
        motion = parse_motion(frame.data)
        turns = self._servos.turns_ticks(frame.servo_id, motion.position_ticks)
        return _Seen(motion, turns, alert=bool(frame.error & ALERT))

    def _believe(self, servo_id: int, seen: _Seen, frame: StatusFrame, now_s: float) -> None:
        self._seen[servo_id] = seen
        climate = parse_climate(frame.data)
        if climate is not None:
            self._climate[servo_id] = climate
            self._error_known.discard(servo_id)
        if not seen.alert:
            self._hardware_error.pop(servo_id, None)
        self._read_at_s[servo_id] = now_s
        self._misses_in_row[servo_id] = 0

    def _jumps(self, servo_id: int, seen: _Seen, now_s: float) -> bool:
        """Return True when a servo cannot have turned from its last reading to this one."""
        before = self._seen.get(servo_id)
        if before is None:
            return False
        way_rad = abs(seen.ticks - before.ticks) * RAD_PER_TICK
        return way_rad > JUMP_RAD + FREE_SPEED_RAD_S * (now_s - self._read_at_s[servo_id])

    def _current_a(self, servo_id: int, motion: Motion) -> float:
        return motion.current * AMPERE_PER_UNIT if self._servos.models[servo_id].has_current else float("nan")


class _Seen(NamedTuple):
    """Latest good reading of one servo."""

    motion: Motion
    turns_ticks: int
    alert: bool

    @property
    def ticks(self) -> int:
        """Position as the calibration counts."""
        return self.motion.position_ticks + self.turns_ticks
