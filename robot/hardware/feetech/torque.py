"""Switching the servos' torque on without a jump, off without a fall, and off at once.

Torque on with a stale goal strips gears: the goal is set to the present position and read back before torque comes on,
with the torque limited and then raised slowly. An arm that is already holding keeps its goals. Every public operation
is a sequence (:mod:`robot.hardware.interface`) that may be abandoned between any two of its steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robot.errors import NoReply, StartupError
from robot.hardware.feetech.bus import STEP_ATTEMPTS, Bus, read, read_block, write_verified
from robot.hardware.feetech.registers import (
    GOAL_ADDRESS,
    TELEMETRY_ADDRESS,
    TELEMETRY_BYTES,
    Register,
    encode,
    parse_telemetry,
)
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.feetech.survey import read_control
from robot.hardware.interface import Steps

# Largest distance from the goal when torque comes on; more means that the arm moved or the goal was not taken.
TORQUE_ON_WITHIN_TICKS = 30

# Further outside its soft limits than this (9 deg) an arm is not switched on.
OUTSIDE_LIMIT_TICKS = 100

# An arm counts as at rest when three readings of each joint lie within this many ticks (0.7 deg).
REST_READINGS = 3
REST_WITHIN_TICKS = 8
REST_INTERVAL_S = 0.02
REST_ATTEMPTS = 50

# Torque limit when torque comes on [0.1 %], and the ramp from there to the full value.
FIRST_TORQUE = 300
RAISE_STEPS = 10
RAISE_S = 0.5

# Ramp of relaxing: the arm sinks instead of falling.
LOWER_STEPS = 50
LOWER_S = 1.5

# An emergency stop is broadcast three times, so that it survives a disturbed line.
BROADCASTS = 3
BROADCAST_INTERVAL_S = 0.002

# A servo that does not confirm that torque is off is tried again after the others: a line or computer that is busy for
# a tenth of a second must not leave a servo driven.
OFF_ROUNDS = 3
OFF_INTERVAL_S = 0.05


@dataclass(frozen=True)
class TickLimits:
    """Limits of the servos' positions.

    Attributes:
        soft: lowest and highest tick of the soft limits, by id.
        servo: registers MIN_ANGLE_LIMIT and MAX_ANGLE_LIMIT, by id; (0, 0) means none.
    """

    soft: Mapping[int, tuple[int, int]]
    servo: Mapping[int, tuple[int, int]]

    def check(self, servos: ServoMap, servo_id: int, present_ticks: int) -> None:
        """Raise StartupError for a servo that must not be switched on at its position."""
        soft, own = self.soft[servo_id], self.servo[servo_id]
        inside = soft[0] - OUTSIDE_LIMIT_TICKS <= present_ticks <= soft[1] + OUTSIDE_LIMIT_TICKS
        # The servo clamps its goal to its own limits: torque would move it there at once.
        jump = abs(self.reachable(servo_id, present_ticks) - present_ticks)
        if not inside or jump > TORQUE_ON_WITHIN_TICKS // 2:
            lowest, highest = soft if jump == 0 else own
            raise StartupError(
                f"joint {servos.by_id[servo_id].joint} stands at {present_ticks} ticks, outside {lowest} to {highest}: "
                "bring it inside by hand, or check the calibration"
            )

    def reachable(self, servo_id: int, ticks: int) -> int:
        """Return the goal nearest to ``ticks`` that the servo does not clamp."""
        lowest, highest = self.servo[servo_id]
        return ticks if (lowest, highest) == (0, 0) else max(lowest, min(highest, ticks))


def enable(bus: Bus, servos: ServoMap, limits: TickLimits, ids: Sequence[int]) -> Steps[dict[int, int]]:
    """Switch servos on at their positions.

    Args:
        bus: an open bus.
        servos: servos of the arm.
        limits: limits of their positions.
        ids: servos to switch on; the others are only read.

    Returns:
        Goals of all servos, positions for those that do not hold, by id [ticks].

    Raises:
        StartupError: the arm moves, stands outside its limits, or does not take a value; servos relaxed before are
            relaxed again.
        NoReply: a servo gave no valid reply; as above.
        PortLost: the port is gone.
    """
    controls, goals = {}, {}
    for servo in servos.ids:
        controls[servo] = yield from read_control(bus, servo)
        present = yield from _present_ticks(bus, servo)
        goals[servo] = controls[servo].goal_ticks if controls[servo].torque_on else present
        if servo in ids:
            limits.check(servos, servo, present)
    relaxed = [servo for servo in ids if not controls[servo].torque_on]
    try:
        yield from _await_rest(bus, servos, relaxed)
        for servo in relaxed:
            goals[servo] = yield from _switch_on(bus, servos, servo, limits)
        start = {servo: controls[servo].torque_limit_permille for servo in ids}
        start |= {servo: _first_torque(servos, servo) for servo in relaxed}
        yield from _raise_torque(bus, servos, start)
    except (StartupError, NoReply) as error:
        left = yield from switch_off(bus, relaxed)
        if left:
            names = ", ".join(servos.label(servo) for servo in left)
            raise StartupError(f"{error}; torque off could not be verified at {names}") from error
        raise
    return goals


def relax(bus: Bus, servos: ServoMap, start_permille: dict[int, int]) -> Steps[list[int]]:
    """Lower the torque limits, then switch torque off and verify that.

    Args:
        bus: an open bus.
        servos: servos of the arm.
        start_permille: torque limits to begin with, by servo id [0.1 %].

    Returns:
        Servos that may still be driven: torque off could not be verified.

    Raises:
        PortLost: the port is gone.
    """
    for step in range(1, LOWER_STEPS + 1):
        yield LOWER_S / LOWER_STEPS
        left = LOWER_STEPS - step
        _write_torque_limits(bus, {servo: limit * left // LOWER_STEPS for servo, limit in start_permille.items()})
    driven = yield from switch_off(bus, list(servos.ids))
    if not driven:
        # The next program that switches torque on finds an arm that can hold itself.
        _write_torque_limits(bus, full_torque(servos))
    return driven


def emergency_stop(bus: Bus, servos: ServoMap) -> Steps[list[int]]:
    """Switch torque off everywhere at once, then verify it servo by servo.

    The first broadcast is sent with the first step, without a wait.

    Returns:
        Servos that may still be driven.

    Raises:
        PortLost: the port is gone.
    """
    for _ in range(BROADCASTS):
        bus.broadcast_torque_off()
        yield BROADCAST_INTERVAL_S
    return (yield from switch_off(bus, list(servos.ids)))


def switch_off(bus: Bus, ids: list[int]) -> Steps[list[int]]:
    """Switch torque off servo by servo, and verify that.

    Returns:
        Servos that may still be driven.

    Raises:
        PortLost: the port is gone.
    """
    driven = yield from _switch_off_once(bus, ids)
    for _ in range(OFF_ROUNDS - 1):
        if not driven:
            break
        yield OFF_INTERVAL_S
        driven = yield from _switch_off_once(bus, driven)
    return driven


def clear_overload(bus: Bus, servos: ServoMap, limits: TickLimits, servo_id: int) -> Steps[None]:
    """Switch a servo whose overload protection has latched off, and on at its position.

    Raises:
        StartupError: it ignores torque off, does not take a value, or moves.
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    try:
        yield from write_verified(bus, servo_id, Register.TORQUE_ENABLE, 0)
    except StartupError as error:
        raise StartupError(
            f"the overload of {servos.label(servo_id)} stays latched, and the servo ignores torque off: switch the "
            "servos' supply off and on"
        ) from error
    yield from _switch_on(bus, servos, servo_id, limits)


def full_torque(servos: ServoMap) -> dict[int, int]:
    """Return register TORQUE_LIMIT of each servo that holds, by id [0.1 %]."""
    return dict(zip(servos.ids, servos.full_torque.tolist(), strict=True))


def _present_ticks(bus: Bus, servo_id: int) -> Steps[int]:
    frame = yield from read_block(bus, servo_id, TELEMETRY_ADDRESS, TELEMETRY_BYTES)
    return parse_telemetry(frame.data).position_ticks


def _await_rest(bus: Bus, servos: ServoMap, ids: list[int]) -> Steps[None]:
    """Wait until the arm is at rest."""
    moving = -1
    for _ in range(REST_ATTEMPTS if ids else 0):
        readings: dict[int, list[int]] = {servo: [] for servo in ids}
        for _ in range(REST_READINGS):
            yield REST_INTERVAL_S
            for servo, frame in bus.sync_read(ids, TELEMETRY_ADDRESS, TELEMETRY_BYTES).items():
                readings[servo].append(parse_telemetry(frame.data).position_ticks)
        moving = next((servo for servo, ticks in readings.items() if not _at_rest(ticks)), -1)
        if moving < 0:
            return
    if moving >= 0:
        raise StartupError(f"joint {servos.by_id[moving].joint} does not come to rest: let go of the arm")


def _at_rest(ticks: list[int]) -> bool:
    return len(ticks) > 1 and max(ticks) - min(ticks) <= REST_WITHIN_TICKS


def _switch_on(bus: Bus, servos: ServoMap, servo_id: int, limits: TickLimits) -> Steps[int]:
    """Switch torque on at the present position and at reduced torque; return the goal [ticks]."""
    yield from write_verified(bus, servo_id, Register.TORQUE_LIMIT, _first_torque(servos, servo_id))
    goal = limits.reachable(servo_id, (yield from _present_ticks(bus, servo_id)))
    yield from _set_goal(bus, servos, servo_id, goal)
    now = yield from _present_ticks(bus, servo_id)
    _check_still(servos, servo_id, now - goal, "before")
    yield from write_verified(bus, servo_id, Register.TORQUE_ENABLE, 1)
    now = yield from _present_ticks(bus, servo_id)
    _check_still(servos, servo_id, now - goal, "while")
    return goal


def _set_goal(bus: Bus, servos: ServoMap, servo_id: int, goal_ticks: int) -> Steps[None]:
    block = servos.goal_block(servo_id, goal_ticks)
    for _ in range(STEP_ATTEMPTS):
        yield 0.0
        bus.sync_write(GOAL_ADDRESS, {servo_id: block})
        if (yield from read(bus, servo_id, Register.GOAL_POSITION)) == goal_ticks:
            return
    raise StartupError(f"servo {servos.label(servo_id)} does not take the goal {goal_ticks}")


def _check_still(servos: ServoMap, servo_id: int, moved_ticks: int, when: str) -> None:
    if abs(moved_ticks) > TORQUE_ON_WITHIN_TICKS:
        joint = servos.by_id[servo_id].joint
        raise StartupError(f"joint {joint} moved by {moved_ticks} ticks {when} torque came on; torque is off")


def _raise_torque(bus: Bus, servos: ServoMap, start_permille: dict[int, int]) -> Steps[None]:
    """Raise the torque limits from their present to their full values."""
    full = full_torque(servos)
    start = {servo: limit for servo, limit in start_permille.items() if limit != full[servo]}
    for step in range(1, RAISE_STEPS + 1 if start else 0):
        yield RAISE_S / RAISE_STEPS
        _write_torque_limits(
            bus, {servo: limit + (full[servo] - limit) * step // RAISE_STEPS for servo, limit in start.items()}
        )
    for servo in start:
        yield from write_verified(bus, servo, Register.TORQUE_LIMIT, full[servo])


def _first_torque(servos: ServoMap, servo_id: int) -> int:
    return min(FIRST_TORQUE, full_torque(servos)[servo_id])


def _write_torque_limits(bus: Bus, permille: dict[int, int]) -> None:
    bus.sync_write(
        Register.TORQUE_LIMIT, {servo: encode(Register.TORQUE_LIMIT, value) for servo, value in permille.items()}
    )


def _switch_off_once(bus: Bus, ids: list[int]) -> Steps[list[int]]:
    driven = []
    for servo in ids:
        try:
            if (yield from read(bus, servo, Register.TORQUE_ENABLE)) != 0:
                yield from write_verified(bus, servo, Register.TORQUE_ENABLE, 0)
        except (StartupError, NoReply):
            driven.append(servo)
    return driven
