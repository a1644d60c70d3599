"""Calibration of the arm as lerobot does it: its middle pose, then a sweep of every joint from stop to stop.

lerobot sets the homing offsets before the sweep. Here nothing is written before the sweep is complete: positions are
tracked across the seam between ticks 4095 and 0 and shifted to the new offset afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robot.calibration import (
    MAX_HOMING_OFFSET,
    MAX_TICK,
    TICKS_PER_TURN,
    Calibration,
    JointCalibration,
)
from robot.commissioning.scan import ServoReport
from robot.description.servo_table import ServoSpec
from robot.errors import CalibrationError
from robot.hardware.feetech.bus import Bus, read, write_verified
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import Steps

# Tick of the middle pose in lerobot.
MIDDLE_TICK = 2047

# Least range of a sweep; the smallest range of a joint, the gripper's, has 1400 ticks.
LEAST_SWEEP_TICKS = 500

# lerobot's format takes MIDDLE_TICK for the middle of the joint that turns freely; further off (9 deg) its zero would
# be wrong.
FREE_MIDDLE_WITHIN_TICKS = 100


class Sweep:
    """Ranges covered by the servos, tracked across the seam.

    Args:
        middle_ticks: positions in the middle pose, by servo id.

    Attributes:
        middle: as given.
        lowest: lowest position so far, by servo id [ticks].
        highest: highest position so far, by servo id [ticks].
        present: latest position, by servo id [ticks].
    """

    def __init__(self, middle_ticks: Mapping[int, int]) -> None:
        self.middle = dict(middle_ticks)
        self.lowest = dict(middle_ticks)
        self.highest = dict(middle_ticks)
        self.present = dict(middle_ticks)

    def add(self, ticks: Mapping[int, int]) -> None:
        """Add positions of some servos, by id [ticks]; a joint must turn by less than half a turn between readings."""
        for servo_id, reading in ticks.items():
            half = TICKS_PER_TURN // 2
            moved = (reading - self.present[servo_id] + half) % TICKS_PER_TURN - half
            position = self.present[servo_id] + moved
            self.present[servo_id] = position
            self.lowest[servo_id] = min(self.lowest[servo_id], position)
            self.highest[servo_id] = max(self.highest[servo_id], position)


def calibrate(servos: Sequence[ServoSpec], sweep: Sweep, offsets: Mapping[int, int], *, recentre: bool) -> Calibration:
    """Compute the calibration from a sweep.

    Args:
        servos: servos of the arm.
        sweep: ranges of all its servos.
        offsets: register HOMING_OFFSET during the sweep, by servo id [ticks].
        recentre: True for new homing offsets, which must then be written to the servos; False to keep theirs.

    Raises:
        CalibrationError: a joint was not swept, or its range would cross the seam.
    """
    return Calibration(tuple(_joint(servo, sweep, offsets[servo.servo_id], recentre=recentre) for servo in servos))


@dataclass(frozen=True)
class Difference:
    """Register of a servo that differs from the calibration."""

    joint: str
    servo_id: int
    register: Register
    calibrated: int
    in_servo: int


def calibrated_registers(joint: JointCalibration) -> dict[Register, int]:
    """Return the registers of a joint's calibration with their values."""
    return {
        Register.HOMING_OFFSET: joint.homing_offset,
        Register.MIN_ANGLE_LIMIT: joint.range_min,
        Register.MAX_ANGLE_LIMIT: joint.range_max,
    }


def differences(calibration: Calibration, servos: Sequence[ServoReport]) -> list[Difference]:
    """Compare a calibration with the servos' registers; missing servos are left out."""
    reports = {servo.servo_id: servo for servo in servos}
    found = []
    for joint in calibration.joints:
        if (report := reports.get(joint.servo_id)) is None:
            continue
        held = {
            Register.HOMING_OFFSET: report.homing_offset_ticks,
            Register.MIN_ANGLE_LIMIT: report.angle_limits_ticks[0],
            Register.MAX_ANGLE_LIMIT: report.angle_limits_ticks[1],
        }
        found += [
            Difference(joint.joint, joint.servo_id, register, value, held[register])
            for register, value in calibrated_registers(joint).items()
            if held[register] != value
        ]
    return found


def write_to_servos(bus: Bus, changes: Sequence[Difference]) -> Steps[None]:
    """Write a calibration to the servos, as a sequence; EPROM wears, so only what differs is written.

    Args:
        bus: an open bus; the servos' torque must be off, since a new homing offset moves their goal.
        changes: result of :func:`differences`.

    Raises:
        StartupError: a servo keeps another value.
        NoReply: a servo gave no valid reply.
        PortLost: the port is gone.
    """
    for servo_id in dict.fromkeys(change.servo_id for change in changes):
        yield from write_verified(bus, servo_id, Register.TORQUE_ENABLE, 0)
        yield from write_verified(bus, servo_id, Register.LOCK, 0)
        for change in changes:
            if change.servo_id != servo_id:
                continue
            if (yield from read(bus, servo_id, change.register)) != change.calibrated:
                yield from write_verified(bus, servo_id, change.register, change.calibrated)
        yield from write_verified(bus, servo_id, Register.LOCK, 1)


def _joint(servo: ServoSpec, sweep: Sweep, offset: int, *, recentre: bool) -> JointCalibration:
    servo_id = servo.servo_id
    middle = sweep.middle[servo_id]
    new_offset = _centring_offset(middle + offset) if recentre else offset
    shift = (middle + offset - new_offset) % TICKS_PER_TURN - middle if recentre else 0
    if servo.turns_freely:
        _check_free_middle(servo.joint, middle + shift)
        lowest, highest = 0, MAX_TICK
    else:
        lowest, highest = sweep.lowest[servo_id] + shift, sweep.highest[servo_id] + shift
        _check_range(servo.joint, lowest, highest, recentre=recentre)
    return JointCalibration(servo, servo_id, 0, new_offset, lowest, highest)


def _centring_offset(encoder_ticks: int) -> int:
    """Compute the homing offset that makes an encoder position the middle; the register cannot hold 2048."""
    offset = (encoder_ticks - MIDDLE_TICK) % TICKS_PER_TURN
    if offset > TICKS_PER_TURN // 2:
        offset -= TICKS_PER_TURN
    return min(offset, MAX_HOMING_OFFSET)


def _check_free_middle(name: str, middle: int) -> None:
    if abs(middle - MIDDLE_TICK) > FREE_MIDDLE_WITHIN_TICKS:
        raise CalibrationError(
            "sweep",
            name,
            f"its middle is tick {middle}, and the file's format takes {MIDDLE_TICK} for it: the servo needs a new "
            "homing offset (--write-servos)",
        )


def _check_range(name: str, lowest: int, highest: int, *, recentre: bool) -> None:
    if highest - lowest < LEAST_SWEEP_TICKS:
        raise CalibrationError(
            "sweep", name, f"was moved by {highest - lowest} ticks only: move every joint from stop to stop"
        )
    if lowest < 0 or highest > MAX_TICK:
        remedy = "begin with it in the middle of its range" if recentre else "its servo needs a new homing offset"
        option = "" if recentre else " (--write-servos)"
        raise CalibrationError(
            "sweep",
            name,
            f"its range of {lowest} to {highest} ticks crosses the seam between {MAX_TICK} and 0: {remedy}{option}",
        )
