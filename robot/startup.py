"""Taking over the servos without a jump: find them, check them, hold them where they are.

Torque on with a stale goal register is how gears are stripped, so nothing here assumes what a servo's registers
hold: the goal is set to the present position and read back before torque comes on, with torque capped and then
raised slowly. An arm that is already holding is adopted as it is.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

from robot.bus import Bus
from robot.calibration import Calibration, JointCalibration
from robot.errors import NoReply, StartupError
from robot.registers import (
    GOAL_ADDRESS,
    TELEMETRY_ADDRESS,
    TELEMETRY_BYTES,
    Register,
    Telemetry,
    encode,
    goal_block,
    parse_telemetry,
)

MODEL_STS3215 = 777
POSITION_MODE = 0

# The register's largest value, 39 rad/s^2: smoothness comes from the trajectory, and any less adds lag.
SERVO_ACCELERATION = 254

# A holding arm whose goal is nearer than this to where it is keeps its goal (5 deg: droop and backlash).
ADOPT_WITHIN_TICKS = 60

# Torque must come on with the arm at its goal; more means the arm moved or the goal was not taken.
TORQUE_ON_WITHIN_TICKS = 30

# Further outside its soft limits than this (9 deg) an arm is not switched on.
OUTSIDE_LIMIT_TICKS = 100

# Torque limit register in 0.1 %: first touch, then full, the gripper less so that it does not burn on its grip.
FIRST_TORQUE = 300
FULL_TORQUE = 800
GRIPPER_TORQUE = 500
TORQUE_RAMP_STEPS = 10
TORQUE_RAMP_S = 0.5

READ_ATTEMPTS = 3


@dataclass(frozen=True)
class TakenOver:
    """The arm after a successful start.

    Attributes:
        goal_ticks: what each servo holds, by servo id.
        adopted: whether the arm was already holding.
    """

    goal_ticks: dict[int, int]
    adopted: bool


def take_over(
    bus: Bus,
    calibration: Calibration,
    soft_limits_ticks: dict[int, tuple[int, int]],
    velocity_cap_ticks_s: dict[int, int],
    sleep: Callable[[float], None],
) -> TakenOver:
    """Bring every servo to hold its present position.

    Args:
        bus: the open bus.
        calibration: joints and servo ids.
        soft_limits_ticks: lowest and highest tick of each servo.
        velocity_cap_ticks_s: Goal_Velocity of each servo.
        sleep: waits between the steps of the torque ramp [s].

    Raises:
        StartupError: a servo is missing, is not an STS3215 in position mode, or stands outside its limits.
        BusError: the bus failed on the way.
    """
    _check_servos(bus, calibration)
    present = {servo: reading.position_ticks for servo, reading in read_all(bus, calibration).items()}
    holding = {joint.servo_id: bus.read(joint.servo_id, Register.TORQUE_ENABLE) == 1 for joint in calibration.joints}
    goals: dict[int, int] = {}
    for joint in calibration.joints:
        servo = joint.servo_id
        goal = bus.read(joint.servo_id, Register.GOAL_POSITION) if holding[servo] else present[servo]
        goals[servo] = goal if abs(goal - present[servo]) <= ADOPT_WITHIN_TICKS else present[servo]
        _check_inside(joint, present[servo], soft_limits_ticks[servo])
    for joint in calibration.joints:
        if not holding[joint.servo_id]:
            _switch_on(bus, joint, goals[joint.servo_id], velocity_cap_ticks_s[joint.servo_id])
    adopted = all(holding.values())
    if not adopted:
        _raise_torque(bus, calibration, sleep)
    return TakenOver(goals, adopted)


def read_all(bus: Bus, calibration: Calibration) -> dict[int, Telemetry]:
    """Telemetry of every servo, by id.

    Raises:
        StartupError: a servo did not answer.
    """
    ids = [joint.servo_id for joint in calibration.joints]
    found: dict[int, Telemetry] = {}
    for _ in range(READ_ATTEMPTS):
        for servo, frame in bus.sync_read(ids, TELEMETRY_ADDRESS, TELEMETRY_BYTES).items():
            found[servo] = parse_telemetry(frame.data)
        if len(found) == len(ids):
            return found
    missing = [joint.joint for joint in calibration.joints if joint.servo_id not in found]
    raise StartupError(f"no telemetry from {', '.join(missing)} in {READ_ATTEMPTS} reads")


def _check_servos(bus: Bus, calibration: Calibration) -> None:
    missing = []
    for joint in calibration.joints:
        model = _ping(bus, joint.servo_id)
        if model is None:
            missing.append(f"{joint.joint} (id {joint.servo_id})")
        elif model != MODEL_STS3215:
            raise StartupError(
                f"servo {joint.servo_id} ({joint.joint}) is model {model}, not an STS3215 ({MODEL_STS3215})"
            )
    if len(missing) == len(calibration.joints):
        raise StartupError("no servo answers: is the arm powered, and the adapter's jumper on B?")
    if missing:
        raise StartupError(f"no answer from {', '.join(missing)}: check the cable to the first one named and its id")
    for joint in calibration.joints:
        mode = bus.read(joint.servo_id, Register.OPERATING_MODE)
        if mode != POSITION_MODE:
            raise StartupError(
                f"servo {joint.servo_id} ({joint.joint}) is in operating mode {mode}, not position mode 0"
            )


def _ping(bus: Bus, servo_id: int) -> int | None:
    try:
        return bus.ping(servo_id)
    except NoReply:
        return None


def _write(bus: Bus, joint: JointCalibration, register: Register, value: int) -> None:
    """Write until the register reads back: the reply to a write that worked may be lost as well."""
    for _ in range(READ_ATTEMPTS):
        with contextlib.suppress(NoReply):
            bus.write(joint.servo_id, register, value)
        if bus.read(joint.servo_id, register) == value:
            return
    raise StartupError(f"servo {joint.servo_id} ({joint.joint}) does not take {value} in register {register.name}")


def _check_inside(joint: JointCalibration, present_ticks: int, limits_ticks: tuple[int, int]) -> None:
    lowest, highest = limits_ticks
    if not lowest - OUTSIDE_LIMIT_TICKS <= present_ticks <= highest + OUTSIDE_LIMIT_TICKS:
        raise StartupError(
            f"joint {joint.joint} stands at {present_ticks} ticks, outside {lowest} to {highest}: bring it inside by "
            "hand, or check the calibration"
        )


def _switch_on(bus: Bus, joint: JointCalibration, goal_ticks: int, velocity_cap_ticks_s: int) -> None:
    """Torque on with the goal where the joint is, and at reduced torque."""
    _write(bus, joint, Register.TORQUE_LIMIT, FIRST_TORQUE)
    block = goal_block(goal_ticks, velocity_cap_ticks_s, SERVO_ACCELERATION)
    for _ in range(READ_ATTEMPTS):
        bus.sync_write(GOAL_ADDRESS, {joint.servo_id: block})
        taken = bus.read(joint.servo_id, Register.GOAL_POSITION)
        if taken == goal_ticks:
            break
    else:
        raise StartupError(f"servo {joint.servo_id} ({joint.joint}) took the goal {taken} instead of {goal_ticks}")
    _write(bus, joint, Register.TORQUE_ENABLE, 1)
    now = bus.read(joint.servo_id, Register.PRESENT_POSITION)
    if abs(now - goal_ticks) > TORQUE_ON_WITHIN_TICKS:
        bus.broadcast_torque_off()
        raise StartupError(f"joint {joint.joint} moved by {now - goal_ticks} ticks while torque came on; torque is off")


def _raise_torque(bus: Bus, calibration: Calibration, sleep: Callable[[float], None]) -> None:
    for step in range(1, TORQUE_RAMP_STEPS + 1):
        limits = {}
        for joint in calibration.joints:
            full = GRIPPER_TORQUE if joint.is_gripper else FULL_TORQUE
            value = FIRST_TORQUE + (full - FIRST_TORQUE) * step // TORQUE_RAMP_STEPS
            limits[joint.servo_id] = encode(Register.TORQUE_LIMIT, value)
        bus.sync_write(Register.TORQUE_LIMIT, limits)
        sleep(TORQUE_RAMP_S / TORQUE_RAMP_STEPS)
