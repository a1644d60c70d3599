"""Finding out what is on the bus before anything is written to it: the right servos, and what they are doing.

Nothing here assumes what a servo's registers hold: torque may be on or off at power-up, and the goal may be anything.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

from robot.calibration import JointCalibration
from robot.errors import NoReply, StartupError
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import (
    CONTROL_ADDRESS,
    CONTROL_BYTES,
    VOLT_PER_UNIT,
    Control,
    Register,
    parse_control,
)
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.feetech.transactions import ATTEMPTS, read, read_block
from robot.hardware.steps import Steps

MODEL_STS3215 = 777
POSITION_MODE = 0

# Register PHASE, bit 4: positions count on beyond one turn, and overflow.
PHASE_MULTI_TURN = 0x10

NOBODY_ADVICE = ": is the arm powered, and the adapter's jumper on B?"
MISSING_ADVICE = ": check the cable to the first one named and its id"

# Angle limits that differ from the calibration by more than this many ticks (0.7 deg) were written by another one.
LIMITS_AGREE_WITHIN_TICKS = 8


@dataclass(frozen=True)
class ServoFound:
    """One servo as it was found.

    Attributes:
        control: what it was told before.
        angle_limits_ticks: registers MIN_ANGLE_LIMIT and MAX_ANGLE_LIMIT.
        max_voltage_v: register MAX_VOLTAGE [V].
        max_torque_permille: register MAX_TORQUE, which TORQUE_LIMIT has after power-up.
        warnings: what a person should look after, a sentence each.
    """

    control: Control
    angle_limits_ticks: tuple[int, int]
    max_voltage_v: float
    max_torque_permille: int
    warnings: tuple[str, ...] = ()


def survey(bus: Bus, servos: ServoMap, *, simulated: bool = False) -> Steps[dict[int, ServoFound]]:
    """Find every servo of the arm; writes nothing.

    Args:
        bus: the open bus.
        servos: the arm's servos.
        simulated: whether there is no cable or supply to look after.

    Returns:
        The servos by id.

    Raises:
        StartupError: a servo is missing, or is not an STS3215 in position mode.
        NoReply: a servo fell silent on the way.
        PortLost: the port is gone.
    """
    yield from _check_present(bus, servos, simulated=simulated)
    found = {}
    for joint in servos.joints:
        found[joint.servo_id] = yield from _look_at(bus, joint)
    return found


def _check_present(bus: Bus, servos: ServoMap, *, simulated: bool) -> Steps[None]:
    missing = []
    for joint in servos.joints:
        model = yield from _ping(bus, joint.servo_id)
        if model is None:
            missing.append(servos.label(joint.servo_id))
        elif model != MODEL_STS3215:
            raise StartupError(
                f"servo {joint.servo_id} ({joint.joint}) is model {model}, not an STS3215 ({MODEL_STS3215})"
            )
    if len(missing) == len(servos.joints):
        raise StartupError(f"no servo answers{'' if simulated else NOBODY_ADVICE}")
    if missing:
        raise StartupError(f"no answer from {', '.join(missing)}{'' if simulated else MISSING_ADVICE}")


def _ping(bus: Bus, servo_id: int) -> Steps[int | None]:
    for _ in range(ATTEMPTS):
        yield 0.0
        with contextlib.suppress(NoReply):
            return bus.ping(servo_id, attempts=1)
    return None


def _look_at(bus: Bus, joint: JointCalibration) -> Steps[ServoFound]:
    servo = joint.servo_id
    mode = yield from read(bus, servo, Register.OPERATING_MODE)
    if mode != POSITION_MODE:
        raise StartupError(f"servo {servo} ({joint.joint}) is in operating mode {mode}, not position mode 0")
    lowest = yield from read(bus, servo, Register.MIN_ANGLE_LIMIT)
    highest = yield from read(bus, servo, Register.MAX_ANGLE_LIMIT)
    phase = yield from read(bus, servo, Register.PHASE)
    return ServoFound(
        control=(yield from read_control(bus, servo)),
        angle_limits_ticks=(lowest, highest),
        max_voltage_v=(yield from read(bus, servo, Register.MAX_VOLTAGE)) * VOLT_PER_UNIT,
        max_torque_permille=(yield from read(bus, servo, Register.MAX_TORQUE)),
        warnings=_warnings(joint, (lowest, highest), phase),
    )


def read_control(bus: Bus, servo_id: int) -> Steps[Control]:
    """Read back what a servo was told.

    Raises:
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    frame = yield from read_block(bus, servo_id, CONTROL_ADDRESS, CONTROL_BYTES)
    return parse_control(frame.data)


def _warnings(joint: JointCalibration, limits_ticks: tuple[int, int], phase: int) -> tuple[str, ...]:
    said = []
    calibrated = joint.range_min, joint.range_max
    if max(abs(a - b) for a, b in zip(limits_ticks, calibrated, strict=True)) > LIMITS_AGREE_WITHIN_TICKS:
        said.append(f"the servo's angle limits {limits_ticks} differ from the calibrated range {calibrated} ticks")
    if phase & PHASE_MULTI_TURN:
        said.append("the servo counts several turns (register PHASE, bit 4), so that its position may overflow")
    return tuple(said)
