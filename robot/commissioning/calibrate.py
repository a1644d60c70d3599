"""Calibration of the arm from a sweep by hand, in lerobot's terms, and its comparison with the servos' registers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robot.calibration import Calibration, JointCalibration
from robot.commissioning.servo_registers import ServoRegisters
from robot.commissioning.sweep import Sweep, met_both_stops, place, place_free
from robot.description.servo_table import ServoSpec
from robot.errors import CalibrationError
from robot.hardware.feetech.calibration import calibrated_registers
from robot.hardware.servos.family import Difference


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
    """Compute the calibration: with new homing offsets for the servos where ``recentre`` is True, else with theirs."""
    return Calibration(tuple(_joint(servo, swept, recentre=recentre) for servo in servos))


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
