"""Calibration of the arm from a sweep by hand, in lerobot's terms, and its comparison with the servos' registers."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robot.calibration import Calibration, JointCalibration
from robot.commissioning.servo_registers import ServoRegisters
from robot.commissioning.sweep import Sweep, met_both_stops, place, place_free
from robot.description.servo_table import ServoSpec
from robot.errors import CalibrationError, PortError, RobotError
from robot.hardware.feetech.bus import ATTEMPTS, Bus, read, write_verified
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import Result, Steps, run_to_end


@dataclass(frozen=True)
class Swept:
    """All that was measured by hand."""

    sweep: Sweep
    offsets: Mapping[int, int]  # register HOMING_OFFSET during the sweep, by servo id [ticks]
    # Position in its middle of each joint without stops, by servo id [ticks], in the sweep's count.
    middles: Mapping[int, int]
    # 1 for servos that turn the other way than the format takes them to, by servo id; 0 for others.
    drive_modes: Mapping[int, int]


def needs_middle(servo: ServoSpec, sweep: Sweep) -> bool:
    """Return True for a joint whose middle does not follow from its sweep: it has no stops, or did not meet them."""
    return servo.turns_freely and not met_both_stops(servo, sweep.width(servo.servo_id))


def calibrate(servos: Sequence[ServoSpec], swept: Swept, *, recentre: bool) -> Calibration:
    """Compute the calibration.

    Args:
        recentre: True for new homing offsets, which must then be written to the servos; False to keep theirs.

    Raises:
        CalibrationError: a joint was not swept, or its range would cross the seam.
    """
    return Calibration(tuple(_joint(servo, swept, recentre=recentre) for servo in servos))


@dataclass(frozen=True)
class Difference:
    """Register of a servo that differs from the calibration."""

    joint: str
    servo_id: int
    register: Register
    calibrated: int
    in_servo: int


def calibrated_registers(joint: JointCalibration) -> dict[Register, int]:
    """Return the registers of a joint's calibration with their values, in the order in which they are written.

    The offset comes last: an interrupted write never leaves a new offset with old limits.
    """
    return {
        Register.MIN_ANGLE_LIMIT: joint.range_min,
        Register.MAX_ANGLE_LIMIT: joint.range_max,
        Register.HOMING_OFFSET: joint.homing_offset,
    }


def differences(calibration: Calibration, servos: Sequence[ServoRegisters]) -> list[Difference]:
    """Compare a calibration with the servos' registers; missing servos are left out."""
    found = {servo.servo_id: servo for servo in servos}
    return [
        Difference(joint.joint, joint.servo_id, register, value, found[joint.servo_id][register])
        for joint in calibration.joints
        if joint.servo_id in found
        for register, value in calibrated_registers(joint).items()
        if found[joint.servo_id][register] != value
    ]


def read_differences(bus: Bus, calibration: Calibration) -> Steps[list[Difference]]:
    """Compare a calibration with the servos' registers, as a sequence."""
    found = []
    for joint in calibration.joints:
        for register, value in calibrated_registers(joint).items():
            held = yield from read(bus, joint.servo_id, register)
            if held != value:
                found.append(Difference(joint.joint, joint.servo_id, register, value, held))
    return found


def write_to_servos(bus: Bus, changes: Sequence[Difference]) -> Steps[None]:
    """Write a calibration to the servos, as a sequence; EPROM wears, so only what differs is written.

    A servo takes all of its changes or, after an error or when the sequence is given up, none, as far as it answers.
    Its EPROM is locked again in either case.

    Args:
        bus: an open bus; the servos' torque must be off, since a new homing offset moves their goal.

    Raises:
        StartupError: a servo keeps another value.
    """
    for servo_id in dict.fromkeys(change.servo_id for change in changes):
        own = [change for change in changes if change.servo_id == servo_id]
        yield from write_verified(bus, servo_id, Register.TORQUE_ENABLE, 0)
        try:
            yield from write_verified(bus, servo_id, Register.LOCK, 0)
            for change in own:
                if (yield from read(bus, servo_id, change.register)) != change.calibrated:
                    yield from write_verified(bus, servo_id, change.register, change.calibrated)
            yield from write_verified(bus, servo_id, Register.LOCK, 1)
        except BaseException:
            _undo_and_lock(bus, servo_id, own)
            raise


def _undo_and_lock(bus: Bus, servo_id: int, changes: Sequence[Difference]) -> None:
    """Undo the changes of a servo that has not taken them all, and lock its EPROM.

    All at once, not in steps: a sequence that is given up has no further steps.
    """
    with contextlib.suppress(RobotError):
        _undo_incomplete(bus, changes)
    for _ in range(ATTEMPTS):
        try:
            _at_once(write_verified(bus, servo_id, Register.LOCK, 1))
        except PortError:
            return
        except RobotError:
            continue
        return


def _undo_incomplete(bus: Bus, changes: Sequence[Difference]) -> None:
    """Write the former values back, the offset first, unless the last change has been made and so all have."""
    if _at_once(read(bus, changes[-1].servo_id, changes[-1].register)) == changes[-1].calibrated:
        return
    for change in reversed(changes):
        if _at_once(read(bus, change.servo_id, change.register)) != change.in_servo:
            _at_once(write_verified(bus, change.servo_id, change.register, change.in_servo))


def _at_once(steps: Steps[Result]) -> Result:
    return run_to_end(steps, lambda _wait_s: None)


def _joint(servo: ServoSpec, swept: Swept, *, recentre: bool) -> JointCalibration:
    servo_id = servo.servo_id
    offset, drive_mode = swept.offsets[servo_id], swept.drive_modes.get(servo_id, 0)
    if not needs_middle(servo, swept.sweep):
        placed = place(servo, swept.sweep, offset, recentre=recentre)
    elif servo_id in swept.middles:
        placed = place_free(servo, swept.middles[servo_id], offset, recentre=recentre)
    else:
        raise CalibrationError("sweep", servo.joint, "did not meet two stops, and its middle was not shown")
    return JointCalibration(servo, servo_id, drive_mode, placed.homing_offset, placed.range_min, placed.range_max)
