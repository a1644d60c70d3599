"""Calibration in a servo's EPROM: the registers that hold it, what differs there, and its writing."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence

from robot.calibration import Calibration, JointCalibration
from robot.errors import PortError, RobotError
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import Result, Steps, run_to_end
from robot.hardware.servos.bus import ATTEMPTS, ServoBus, read, write_verified
from robot.hardware.servos.family import Difference


def calibrated_registers(joint: JointCalibration) -> dict[Register, int]:
    """Return the registers of a joint's calibration with their values, in the order in which they are written.

    The offset comes last: an interrupted write never leaves a new offset with old limits.
    """
    return {
        Register.MIN_ANGLE_LIMIT: joint.range_min,
        Register.MAX_ANGLE_LIMIT: joint.range_max,
        Register.HOMING_OFFSET: joint.homing_offset,
    }


def differences(calibration: Calibration, held: Mapping[int, Mapping[Register, int]]) -> list[Difference]:
    """Compare a calibration with the registers of servos by id; joints of other servos are left out."""
    return [
        Difference(joint.joint, joint.servo_id, register, value, held[joint.servo_id][register])
        for joint in calibration.joints
        if joint.servo_id in held
        for register, value in calibrated_registers(joint).items()
        if held[joint.servo_id][register] != value
    ]


def read_differences(bus: ServoBus, calibration: Calibration) -> Steps[list[Difference]]:
    """Compare a calibration with the servos' registers, as a sequence; raises NoReply."""
    held: dict[int, dict[Register, int]] = {}
    for joint in calibration.joints:
        held[joint.servo_id] = {}
        for register in calibrated_registers(joint):
            held[joint.servo_id][register] = yield from read(bus, joint.servo_id, register)
    return differences(calibration, held)


def write_to_servos(bus: ServoBus, changes: Sequence[Difference]) -> Steps[None]:
    """Write a calibration to servos without torque, as a sequence; EPROM wears, so only what differs is written.

    A servo takes all of its changes or, after an error or when the sequence is given up, none, as far as it answers.
    Its EPROM is locked again in either case. Raises StartupError for a servo that keeps another value, and NoReply.
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


def _undo_and_lock(bus: ServoBus, servo_id: int, changes: Sequence[Difference]) -> None:
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


def _undo_incomplete(bus: ServoBus, changes: Sequence[Difference]) -> None:
    """Write the former values back, the offset first, unless the last change has been made and so all have."""
    if _at_once(read(bus, changes[-1].servo_id, changes[-1].register)) == changes[-1].calibrated:
        return
    for change in reversed(changes):
        if _at_once(read(bus, change.servo_id, change.register)) != change.in_servo:
            _at_once(write_verified(bus, change.servo_id, change.register, change.in_servo))


def _at_once(steps: Steps[Result]) -> Result:
    return run_to_end(steps, lambda _wait_s: None)
