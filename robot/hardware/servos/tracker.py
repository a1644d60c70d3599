"""Readings of the servos, their ages, and the servos to read next.

A servo that does not answer must not hold up the others, nor silence them: a servo that has just missed its
turn is asked last, since servos wait for the reply before theirs, and a servo that stays silent is asked now and then.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from robot.calibration import RAD_PER_TICK
from robot.hardware.interface import Measured
from robot.hardware.servos.bus import StatusFrame
from robot.hardware.servos.family import ServoFamily
from robot.hardware.servos.registers import Telemetry
from robot.hardware.servos.servo_map import ServoMap

MISSES_UNTIL_LAST = 2  # misses in a row after which a servo is asked behind the others

# Reads in a row without any reply, for each servo, after which all count as silent: each has been the first once.
EMPTY_READS_PER_SERVO = MISSES_UNTIL_LAST

# A servo that has missed this many reads in a row is read less often: waiting for it costs half of a period. As many as
# make its reading stale, so that it never counts as lost because it was not read.
MISSES_UNTIL_SILENT = 10
ASK_SILENT_EVERY = 10

# When none replies, waiting for all of them takes most of a period. The cycles in between leave time for sequences: an
# emergency stop must be able to report that no servo confirms it.
ASK_ALL_EVERY = 3


class ServoTracker:
    """Latest readings of an arm's servos."""

    def __init__(self, family: ServoFamily, servos: ServoMap) -> None:
        self._family = family
        self._servos = servos
        self._seen: dict[int, Telemetry] = {}
        self._error_known: set[int] = set()
        self._read_at_s: dict[int, float] = {}
        self._frames: Mapping[int, StatusFrame] = {}
        self._measured: Measured | None = None
        self._complete = False
        self._cycle = 0
        self._misses_in_row = dict.fromkeys(servos.ids, 0)
        self._empty_reads = 0
        self._suspect_ids: set[int] = set()
        self.silent_cycles = dict.fromkeys(servos.ids, 0)

    @property
    def complete(self) -> bool:
        """True when every servo has answered at least once, with its supply and temperature."""
        if not self._complete:
            supplied = [reading for reading in self._seen.values() if not math.isnan(reading.voltage_v)]
            self._complete = len(supplied) == len(self._servos.ids)
        return self._complete

    def ids_to_ask(self) -> list[int]:
        """Choose the servos to read in this cycle: those that have missed their turn last, silent ones now and then."""
        self._cycle += 1
        misses = self._misses_in_row
        prompt = [servo for servo in self._servos.ids if misses[servo] < MISSES_UNTIL_LAST]
        if len(prompt) == len(misses):
            return prompt
        late = [servo for servo in self._servos.ids if MISSES_UNTIL_LAST <= misses[servo] < MISSES_UNTIL_SILENT]
        silent = [servo for servo in self._servos.ids if self.is_silent(servo)]
        speaking = prompt + late
        every = ASK_SILENT_EVERY if speaking else ASK_ALL_EVERY
        return speaking if self._cycle % every else speaking + silent

    def is_silent(self, servo_id: int) -> bool:
        """Return True for a servo that is read less often, because it has missed many reads in a row."""
        return self._misses_in_row[servo_id] >= MISSES_UNTIL_SILENT

    def ask_again(self, servo_id: int) -> None:
        """Ask a servo in the next cycle, though it was silent."""
        self._misses_in_row[servo_id] = 0

    def alerting(self) -> list[int]:
        """Return the servos that report an error which has not been read lately."""
        return [servo for servo, seen in self._seen.items() if seen.reports_error and servo not in self._error_known]

    def take_error(self, servo_id: int, status: int) -> None:
        """Take the status flags of a servo's error register, which count until the servo reports none."""
        self._seen[servo_id].status = status
        self._error_known.add(servo_id)
        self._measured = None

    def turns_ticks(self) -> dict[int, int]:
        """Return the turns to add to positions for the calibrated ones, by id; empty for servos without turns."""
        if not self._family.counts_turns:
            return {}
        return {servo: seen.turns_ticks for servo, seen in self._seen.items()}

    def take(self, asked: Sequence[int], frames: Mapping[int, StatusFrame], now_s: float) -> None:
        """Take the replies to one block read of servos in this order, which were asked at a monotonic time [s].

        A reading with a jump that no joint can make may be another servo's with a disturbed id: the first one is
        ignored, a second one in a row is believed. When all servos behind a missing one are missing too, they may have
        waited for it, so that it alone has missed its turn.
        """
        if frames is self._frames and len(frames) == len(self._servos.ids) and not self._suspect_ids:
            # The same bytes as in the last cycle, whose readings were believed.
            self._read_at_s = dict.fromkeys(self._servos.ids, now_s)
            return
        self._frames, self._measured = frames, None
        parse, joints = self._family.parse_telemetry, self._servos.by_id
        readings = {servo: parse(frame, joints[servo]) for servo, frame in frames.items()}
        for servo, reading in readings.items() if self._family.counts_turns else ():
            reading.turns_ticks = self._servos.turns_ticks(servo, reading.position_ticks)
            reading.position_ticks += reading.turns_ticks
        jumped = {servo for servo, reading in readings.items() if self._jumps(servo, reading, now_s)}
        believed = readings.keys() - (jumped - self._suspect_ids)
        self._suspect_ids = (self._suspect_ids - frames.keys()) | (jumped - believed)
        self._believe({servo: readings[servo] for servo in believed}, now_s)
        if len(believed) < len(self._servos.ids):
            self._count_misses(asked, frames, believed)
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
        seen = [self._seen[servo] for servo in ids]
        # From plain numbers: an operation on arrays costs more than all the arithmetic for six joints.
        self._measured = Measured(
            position_rad=np.array(servos.positions_rad([each.position_ticks for each in seen])),
            velocity_rad_s=np.array(servos.velocities_rad_s([each.velocity_ticks_s for each in seen])),
            load=np.array(servos.signed([each.load for each in seen])),
            current_a=np.array(servos.signed([each.current_a for each in seen])),
            voltage_v=np.array([each.voltage_v for each in seen]),
            temperature_c=np.array([each.temperature_c for each in seen], dtype=float),
            status=np.array([each.status for each in seen]),
            age_s=age_s,
            stamp_s=stamp_s,
        )
        return self._measured

    def _believe(self, readings: Mapping[int, Telemetry], now_s: float) -> None:
        for servo, reading in readings.items():
            before = self._seen.get(servo, reading)
            if math.isnan(reading.voltage_v):
                reading.voltage_v, reading.temperature_c = before.voltage_v, before.temperature_c
            else:
                self._error_known.discard(servo)
            if reading.reports_error and before.reports_error:
                reading.status = before.status
            self._seen[servo] = reading
            self._read_at_s[servo] = now_s
            self._misses_in_row[servo] = 0

    def _count_misses(self, asked: Sequence[int], frames: Mapping[int, StatusFrame], believed: set[int]) -> None:
        missing = [servo for servo in asked if servo not in frames]
        behind_first = missing[1:] if missing and list(asked[-len(missing) :]) == missing else []
        for servo in self._servos.ids:
            if servo not in believed:
                self._misses_in_row[servo] += servo in asked and servo not in behind_first
                self.silent_cycles[servo] += 1

    def _jumps(self, servo_id: int, reading: Telemetry, now_s: float) -> bool:
        before = self._seen.get(servo_id)
        if before is None:
            return False
        way_rad = abs(reading.position_ticks - before.position_ticks) * RAD_PER_TICK
        free_speed_rad_s = self._family.free_speed_rad_s(self._servos.by_id[servo_id])
        return way_rad > self._family.jump_rad + free_speed_rad_s * (now_s - self._read_at_s[servo_id])
