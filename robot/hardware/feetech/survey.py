"""Survey of the servos before anything is written to them, and register checks while they are driven.

The survey assumes nothing about the registers: torque may be on or off at power-up, and the goal may have any value.

A servo whose supply dips reboots, with torque off and its torque limit at the maximum, which its telemetry does not
show. So the control block of one servo at a time is read back and compared with what was written
(:class:`RegisterChecks`).
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from itertools import cycle

from robot.calibration import JointCalibration
from robot.errors import NoReply, StartupError
from robot.faults import Fault, FaultCode
from robot.hardware.feetech.bus import STEP_ATTEMPTS, Bus, read, read_block
from robot.hardware.feetech.registers import (
    CONTROL_ADDRESS,
    CONTROL_BYTES,
    MODEL_STS3215,
    VOLT_PER_UNIT,
    Control,
    Register,
    parse_control,
)
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.interface import Steps

# Register OPERATING_MODE of a servo that follows position goals.
POSITION_MODE = 0

# Register PHASE, bit 4: positions count on beyond one turn, and overflow.
PHASE_MULTI_TURN = 0x10

NONE_ANSWERS_ADVICE = ": is the arm powered, and the adapter's jumper on B?"
MISSING_ADVICE = ": check the cable to the first one named and its id"

# Angle limits that differ from the calibration by more than this many ticks (0.7 deg) are of another calibration.
LIMITS_AGREE_WITHIN_TICKS = 8

# Cycles between register checks: each of six servos is checked about once a second.
CYCLES_BETWEEN = 16


@dataclass(frozen=True)
class ServoFound:
    """Servo as surveyed.

    Attributes:
        control: commands that it holds.
        angle_limits_ticks: registers MIN_ANGLE_LIMIT and MAX_ANGLE_LIMIT.
        max_voltage_v: register MAX_VOLTAGE [V].
        max_torque_permille: register MAX_TORQUE, the value of TORQUE_LIMIT after power-up.
        warnings: warnings, a sentence each.
    """

    control: Control
    angle_limits_ticks: tuple[int, int]
    max_voltage_v: float
    max_torque_permille: int
    warnings: tuple[str, ...] = ()


def survey(bus: Bus, servos: ServoMap, *, simulated: bool = False) -> Steps[dict[int, ServoFound]]:
    """Survey every servo of the arm, without writing.

    Args:
        bus: an open bus.
        servos: servos of the arm.
        simulated: True for emulated servos, without cable and supply to check.

    Returns:
        Servos by id.

    Raises:
        StartupError: a servo is missing, or is not an STS3215 in position mode.
        NoReply: a servo stopped answering.
        PortLost: the port is gone.
    """
    yield from _check_present(bus, servos, simulated=simulated)
    found = {}
    for joint in servos.joints:
        found[joint.servo_id] = yield from _look_at(bus, joint)
    return found


def read_control(bus: Bus, servo_id: int) -> Steps[Control]:
    """Read the control block of a servo, as a sequence.

    Raises:
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    frame = yield from read_block(bus, servo_id, CONTROL_ADDRESS, CONTROL_BYTES)
    return parse_control(frame.data)


class RegisterChecks:
    """Comparison of the servos' control blocks with what was written to them.

    Args:
        servos: servos of the arm.
        found: servos as surveyed, by id; may be filled later.

    Attributes:
        torque_on: register TORQUE_ENABLE of each servo when it was last read back, by id.
    """

    def __init__(self, servos: ServoMap, found: dict[int, ServoFound]) -> None:
        self._servos = servos
        self._found = found
        self._turn = cycle(servos.ids)
        self._cycle = 0
        self._expected: dict[int, int] = {}
        self.torque_on: dict[int, bool] = {}

    def due(self) -> int | None:
        """Return the servo to read back in this cycle, if any."""
        self._cycle += 1
        return None if self._cycle % CYCLES_BETWEEN else next(self._turn)

    def expect(self, permille: dict[int, int]) -> None:
        """Expect these torque limits, which were written to the servos, by id [0.1 %]."""
        self._expected = dict(permille)
        self.torque_on.clear()

    def limits_to_write(self, permille: dict[int, int]) -> dict[int, int]:
        """Return the torque limits that differ from the expected ones, and expect them, by id [0.1 %]."""
        if permille == self._expected:
            return {}
        changed = {servo: limit for servo, limit in permille.items() if self._expected.get(servo) != limit}
        self._expected.update(changed)
        return changed

    def check(self, servo_id: int, control: Control, stamp_s: float) -> Fault | None:
        """Compare the control block of a driven servo with what was written to it.

        Args:
            servo_id: id of the servo.
            control: its control block.
            stamp_s: wall-clock time [s since the epoch].

        Returns:
            Fault of a servo that has rebooted or was relaxed, None otherwise.
        """
        self.torque_on[servo_id] = control.torque_on
        wanted = self._expected.get(servo_id)
        if wanted != control.torque_limit_permille:
            self._expected.pop(servo_id, None)
        fresh = self._found[servo_id].max_torque_permille
        rebooted = control.torque_limit_permille == fresh != wanted
        joint = self._servos.by_id[servo_id].joint
        if rebooted and wanted is not None:
            return Fault(FaultCode.SERVO_REBOOTED, f"the servo of joint {joint} has started anew", joint, stamp_s)
        if not control.torque_on:
            return Fault(FaultCode.TORQUE_LOST, f"the servo of joint {joint} was found relaxed", joint, stamp_s)
        return None


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
        raise StartupError(f"no servo answers{'' if simulated else NONE_ANSWERS_ADVICE}")
    if missing:
        raise StartupError(f"no answer from {', '.join(missing)}{'' if simulated else MISSING_ADVICE}")


def _ping(bus: Bus, servo_id: int) -> Steps[int | None]:
    for _ in range(STEP_ATTEMPTS):
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


def _warnings(joint: JointCalibration, limits_ticks: tuple[int, int], phase: int) -> tuple[str, ...]:
    said = []
    calibrated = joint.range_min, joint.range_max
    if max(abs(a - b) for a, b in zip(limits_ticks, calibrated, strict=True)) > LIMITS_AGREE_WITHIN_TICKS:
        said.append(f"the servo's angle limits {limits_ticks} differ from the calibrated range {calibrated} ticks")
    if phase & PHASE_MULTI_TURN:
        said.append("the servo counts several turns (register PHASE, bit 4), so that its position may overflow")
    return tuple(said)
