"""Sweep of the joints by hand from stop to stop, and the calibration that follows from it, in lerobot's terms. Pure.

lerobot asks for the middle pose first and sets the homing offsets before the sweep, so that a wrong middle pose makes a
joint cross the seam between ticks 4095 and 0. Here positions are tracked across the seam, nothing is written before the
sweep is complete, and the middle of what was swept becomes the middle of the turn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from robot.calibration import MAX_TICK, RAD_PER_TICK, TICKS_PER_TURN, WIDEST_RANGE_TICKS, Calibration, JointCalibration
from robot.description.servo_table import ServoSpec
from robot.errors import CalibrationError

MIDDLE_TICK = 2047  # tick of the middle in lerobot
LEAST_SWEEP_TICKS = 500  # least range of a sweep; the smallest range of a joint, the gripper's, has 1400 ticks

# The middle of a wider range leaves no room on both sides: the register's 11 bits may put it one tick off.
WIDEST_SWEEP_TICKS = MAX_TICK - 1

# Ranges of measured arms are up to 12 deg narrower than the URDF's, a tenth of the range; a joint that covered less
# than this share has not met both stops.
STOPS_SHARE = 0.8

# A joint that covered less than this share has perhaps met one stop only: half of the missing part is the error of its
# zero, 3 deg for a joint of 200 deg. Its stops then count when it came to both twice.
CERTAIN_SHARE = 0.97

# A stop is met at the same position again, by hand within 2 deg; a hand that turns round before it is not so exact.
SAME_STOP_TICKS = 20

LEFT_STOP_TICKS = 100  # a joint has left its stop at this distance from it, 9 deg

# lerobot's format takes MIDDLE_TICK for the middle of the joint that turns freely; further off (9 deg) its zero would
# be wrong.
FREE_MIDDLE_WITHIN_TICKS = 100


class _End:
    """One end of a joint's way, and the visits to it; positions grow towards the end [ticks]."""

    def __init__(self, position: int) -> None:
        self._stop = position
        self._left = False
        self.visits = 1

    def add(self, position: int) -> None:
        if position > self._stop + SAME_STOP_TICKS or (self.visits == 1 and not self._left and position > self._stop):
            self._stop, self._left, self.visits = position, False, 1
        elif position < self._stop - LEFT_STOP_TICKS:
            self._left = True
        elif self._left and position >= self._stop - SAME_STOP_TICKS:
            self._left = False
            self.visits += 1


class Sweep:
    """Ranges covered by the servos, by servo id [ticks], tracked across the seam: positions go on beyond 0 and 4095."""

    def __init__(self, ticks: Mapping[int, int]) -> None:
        self.lowest = dict(ticks)
        self.highest = dict(ticks)
        self.present = dict(ticks)
        self._ends = {servo_id: (_End(-position), _End(position)) for servo_id, position in ticks.items()}

    def add(self, ticks: Mapping[int, int]) -> None:
        """Add positions of some servos, by id [ticks]; a joint must turn by less than half a turn between readings."""
        for servo_id, reading in ticks.items():
            half = TICKS_PER_TURN // 2
            moved = (reading - self.present[servo_id] + half) % TICKS_PER_TURN - half
            position = self.present[servo_id] + moved
            self.present[servo_id] = position
            self.lowest[servo_id] = min(self.lowest[servo_id], position)
            self.highest[servo_id] = max(self.highest[servo_id], position)
            lower_end, upper_end = self._ends[servo_id]
            lower_end.add(-position)
            upper_end.add(position)

    def width(self, servo_id: int) -> int:
        """Return the width of a servo's range [ticks]."""
        return self.highest[servo_id] - self.lowest[servo_id]

    def came_twice(self, servo_id: int) -> bool:
        """Return True for a servo that came to both ends of its range at least twice."""
        return all(end.visits > 1 for end in self._ends[servo_id])


def expected_width(servo: ServoSpec) -> int:
    """Return the width of the joint's range in the URDF [ticks]."""
    return round((servo.upper_rad - servo.lower_rad) / RAD_PER_TICK)


def met_both_stops(servo: ServoSpec, width_ticks: int) -> bool:
    """Return True for a range as wide as two stops make it; a free joint has none when it covered nearly a turn."""
    if servo.turns_freely and width_ticks > WIDEST_RANGE_TICKS:
        return False
    return width_ticks >= STOPS_SHARE * expected_width(servo)


@dataclass(frozen=True)
class Swept:
    """All that was measured by hand."""

    sweep: Sweep
    offsets: Mapping[int, int]  # register HOMING_OFFSET during the sweep, by servo id [ticks]
    # Position in its middle of each joint without stops, by servo id [ticks], in the sweep's count.
    middles: Mapping[int, int]
    # 1 for servos that turn the other way than the format takes them to, by servo id; 0 for others.
    drive_modes: Mapping[int, int]


class Placed(NamedTuple):
    """Range of a servo under its homing offset."""

    homing_offset: int  # register HOMING_OFFSET [ticks]
    range_min: int  # lowest position [ticks]
    range_max: int  # highest position [ticks]


def needs_middle(servo: ServoSpec, sweep: Sweep) -> bool:
    """Return True for a joint whose middle does not follow from its sweep: it has no stops, or did not meet them."""
    return servo.turns_freely and not met_both_stops(servo, sweep.width(servo.servo_id))


def calibrate(servos: Sequence[ServoSpec], swept: Swept, *, recentre: bool) -> Calibration:
    """Compute the calibration: with new homing offsets for the servos where ``recentre`` is True, else with theirs."""
    return Calibration(tuple(_joint(servo, swept, recentre=recentre) for servo in servos))


def place(servo: ServoSpec, sweep: Sweep, offset: int, *, recentre: bool) -> Placed:
    """Place the swept range of a joint with stops within the turn; the offset is that during the sweep [ticks]."""
    lowest, highest, width = sweep.lowest[servo.servo_id], sweep.highest[servo.servo_id], sweep.width(servo.servo_id)
    if width < LEAST_SWEEP_TICKS:
        raise CalibrationError(
            "sweep", servo.joint, f"was moved by {width} ticks only: move every joint from stop to stop"
        )
    if width > WIDEST_SWEEP_TICKS:
        raise CalibrationError(
            "sweep",
            servo.joint,
            f"was turned by {width} ticks, and has no stops within a turn of {TICKS_PER_TURN}: they are missing, or "
            "its horn slips; a joint without stops has turns_freely = true in robot.toml",
        )
    if recentre:
        middle = (lowest + highest) // 2
        offset, shift = _centred(servo, middle, offset)
        lowest, highest = lowest + shift, highest + shift
    if lowest < 0 or highest > MAX_TICK:
        raise CalibrationError(
            "sweep",
            servo.joint,
            f"its range of {lowest} to {highest} ticks crosses the seam between {MAX_TICK} and 0: its servo needs a "
            "new homing offset (--write-servos)",
        )
    return Placed(offset, lowest, highest)


def place_free(servo: ServoSpec, middle: int, offset: int, *, recentre: bool) -> Placed:
    """Place a joint that turns freely: its range is the turn, its middle the tick that lerobot takes for it [ticks]."""
    if recentre:
        return Placed(_centred(servo, middle, offset)[0], 0, MAX_TICK)
    middle %= TICKS_PER_TURN
    if abs(middle - MIDDLE_TICK) > FREE_MIDDLE_WITHIN_TICKS:
        raise CalibrationError(
            "sweep",
            servo.joint,
            f"its middle is tick {middle}, and the file's format takes {MIDDLE_TICK} for it: the servo needs a new "
            "homing offset (--write-servos)",
        )
    return Placed(offset, 0, MAX_TICK)


def _centred(servo: ServoSpec, middle: int, offset: int) -> tuple[int, int]:
    """Return the homing offset that makes a position the middle, within the register's range, and the shift with it."""
    encoder = middle + offset
    centred = (encoder - MIDDLE_TICK) % TICKS_PER_TURN
    if centred > TICKS_PER_TURN // 2:
        centred -= TICKS_PER_TURN
    centred = min(centred, servo.max_homing_offset)
    return centred, (encoder - centred) % TICKS_PER_TURN - middle


def _joint(servo: ServoSpec, swept: Swept, *, recentre: bool) -> JointCalibration:
    servo_id = servo.servo_id
    offset, drive_mode = swept.offsets[servo_id], swept.drive_modes.get(servo_id, 0)
    if not needs_middle(servo, swept.sweep):
        placed = place(servo, swept.sweep, offset, recentre=recentre)
    elif servo_id in swept.middles:
        placed = place_free(servo, swept.middles[servo_id], offset, recentre=recentre)
    else:
        raise CalibrationError("sweep", servo.joint, "did not meet two stops, and its middle was not shown")
    return JointCalibration(servo, servo_id, drive_mode, *placed)
