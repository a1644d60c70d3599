"""Switching the servos' torque on without a jump, off without a fall, and off at once.

Torque on with a stale goal strips gears: the goal is set to the present position and read back before torque comes on,
with the torque limited and then raised slowly. An arm that is already holding keeps its goals. Every public operation
is a sequence (:mod:`robot.hardware.interface`) that may be abandoned between any two of its steps.

A servo in current-based position mode, the gripper where it has current control, is limited by GOAL_CURRENT, any other
by GOAL_PWM. Every servo that is driven has its bus watchdog armed: it stops by itself when this computer fails.
Positions are as the calibration counts (:mod:`robot.hardware.dynamixel.servo_map`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

from robot.errors import NoReply, StartupError
from robot.hardware.dynamixel.bus import STEP_ATTEMPTS, Bus, ping, read, write_verified
from robot.hardware.dynamixel.registers import FULL_PWM, WATCHDOG_TRIPPED, OperatingMode, Register, encode
from robot.hardware.dynamixel.servo_map import PROFILE_ACCELERATION, ServoMap
from robot.hardware.dynamixel.survey import WATCHDOG, ServoFound, limits_of
from robot.hardware.interface import Steps

# Largest distance from the goal when torque comes on; more means that the arm moved or the goal was not taken.
TORQUE_ON_WITHIN_TICKS = 30

# Largest difference between a goal that was written and the one read back: a relaxed servo may set its goal to its
# position, which jitters.
GOAL_WITHIN_TICKS = 8

# Further outside its soft limits than this (9 deg) an arm is not switched on.
OUTSIDE_LIMIT_TICKS = 100

# An arm counts as at rest when three readings of each joint lie within this many ticks (0.7 deg).
REST_READINGS = 3
REST_WITHIN_TICKS = 8
REST_INTERVAL_S = 0.02
REST_ATTEMPTS = 50

# Torque limit when torque comes on, as a share of full duty, and the ramp from there to the full value.
FIRST_TORQUE = 0.3
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

# Time after which a rebooted servo answers again at the earliest, and intervals and number of further tries. The
# e-manual states none; start-up takes a few tenths of a second.
REBOOT_S = 0.3
REBOOT_RETRY_S = 0.1
REBOOT_TRIES = 20


class ServoTorque:
    """Torque of an arm's servos, which were surveyed.

    Args:
        bus: an open bus.
        servos: servos of the arm.
        found: servos as surveyed, by id; filled before any method is called, and kept up to date by them.
        soft_limits_ticks: lowest and highest position of the soft limits by id [ticks]; filled likewise.
    """

    def __init__(
        self,
        bus: Bus,
        servos: ServoMap,
        found: dict[int, ServoFound],
        soft_limits_ticks: Mapping[int, tuple[int, int]],
    ) -> None:
        self._bus = bus
        self._servos = servos
        self._found = found
        self._soft = soft_limits_ticks

    def enable(self, ids: Sequence[int]) -> Steps[dict[int, int]]:
        """Switch servos on at their positions.

        Args:
            ids: servos to switch on; the others are only read.

        Returns:
            Goals of all servos, positions for those that do not hold, by id [ticks].

        Raises:
            StartupError: the arm moves, stands outside its limits, or does not take a value; servos relaxed before are
                relaxed again.
            NoReply: a servo gave no valid reply; as above.
            PortLost: the port is gone.
        """
        goals: dict[int, int] = {}
        relaxed: list[int] = []
        holding: list[int] = []
        for servo in self._servos.ids:
            present = yield from self._present(servo)
            on = yield from self.is_on(servo)
            goals[servo] = (yield from self.goal(servo)) if on else present
            if servo in ids:
                self._check_position(servo, present)
                (holding if on else relaxed).append(servo)
        for servo in holding:
            goals[servo] = yield from self._take_over(servo, goals[servo])
        try:
            yield from self._await_rest(relaxed)
            for servo in relaxed:
                goals[servo] = yield from self._switch_on(servo)
            yield from self._raise_torque(ids, relaxed)
            for servo in ids:
                yield from self._arm_watchdog(servo)
        except (StartupError, NoReply) as error:
            left = yield from self.switch_off(relaxed)
            if left:
                names = ", ".join(self._servos.label(servo) for servo in left)
                raise StartupError(f"{error}; torque off could not be verified at {names}") from error
            raise
        return goals

    def relax(self, start: Mapping[int, float]) -> Steps[list[int]]:
        """Lower the torque limits, then switch torque off and verify that.

        Args:
            start: torque limits to begin with, as shares of full duty by servo id.

        Returns:
            Servos that may still be driven: torque off could not be verified.

        Raises:
            PortLost: the port is gone.
        """
        for step in range(1, LOWER_STEPS + 1):
            yield LOWER_S / LOWER_STEPS
            left = (LOWER_STEPS - step) / LOWER_STEPS
            self.write_limits({servo: share * left for servo, share in start.items()})
        driven = yield from self.switch_off(self._servos.ids)
        if not driven:
            # The next program that switches torque on finds an arm that can hold itself.
            self.write_limits(self.full_shares())
        return driven

    def emergency_stop(self) -> Steps[list[int]]:
        """Switch torque off everywhere at once, then verify it servo by servo.

        The first broadcast is sent with the first step, without a wait.

        Returns:
            Servos that may still be driven.

        Raises:
            PortLost: the port is gone.
        """
        for _ in range(BROADCASTS):
            self._bus.broadcast_torque_off()
            yield BROADCAST_INTERVAL_S
        return (yield from self.switch_off(self._servos.ids))

    def switch_off(self, ids: Sequence[int]) -> Steps[list[int]]:
        """Switch torque off servo by servo, and verify that.

        Returns:
            Servos that may still be driven.

        Raises:
            PortLost: the port is gone.
        """
        driven = yield from self._switch_off_once(ids)
        for _ in range(OFF_ROUNDS - 1):
            if not driven:
                break
            yield OFF_INTERVAL_S
            driven = yield from self._switch_off_once(driven)
        return driven

    def clear_errors(self, servo_id: int, *, hold: bool) -> Steps[None]:
        """Reboot a servo whose protection has switched it off, the only way to clear that, and switch it on again.

        Args:
            servo_id: id of the servo.
            hold: True to switch it on at its position afterwards.

        Raises:
            StartupError: it does not take a value, or moves.
            NoReply: the servo gave no valid reply.
            PortLost: the port is gone.
        """
        yield 0.0
        with contextlib.suppress(NoReply):
            self._bus.reboot(servo_id)
        yield REBOOT_S
        for attempt in range(REBOOT_TRIES):
            try:
                yield from ping(self._bus, servo_id)
                break
            except NoReply:
                if attempt + 1 == REBOOT_TRIES:
                    raise
                yield REBOOT_RETRY_S
        if hold:
            yield from self._switch_on(servo_id)
            yield from self._raise_torque([servo_id], [servo_id])
            yield from self._arm_watchdog(servo_id)

    def is_on(self, servo_id: int) -> Steps[bool]:
        """Read a servo's TORQUE_ENABLE.

        Raises:
            NoReply: the servo gave no valid reply.
            PortLost: the port is gone.
        """
        return (yield from read(self._bus, servo_id, Register.TORQUE_ENABLE)) == 1

    def goal(self, servo_id: int) -> Steps[int]:
        """Read a servo's goal [ticks].

        Raises:
            NoReply: the servo gave no valid reply.
            PortLost: the port is gone.
        """
        present = yield from read(self._bus, servo_id, Register.PRESENT_POSITION)
        goal = yield from read(self._bus, servo_id, Register.GOAL_POSITION)
        return goal + self._servos.turns_ticks(servo_id, present)

    def full_shares(self) -> dict[int, float]:
        """Return the torque limit of each servo that holds, as a share of full duty by id."""
        return {servo: self._servos.full_share(servo) for servo in self._servos.ids}

    def write_limits(self, shares: Mapping[int, float]) -> None:
        """Write torque limits, which are not acknowledged: two packets where a gripper is limited by its current.

        Args:
            shares: shares of full duty by servo id.

        Raises:
            PortLost: the port is gone.
        """
        blocks: dict[Register, dict[int, bytes]] = {}
        for servo, share in shares.items():
            register, value = self._limit(servo, share)
            blocks.setdefault(register, {})[servo] = encode(register, value)
        for register, data in blocks.items():
            self._bus.sync_write(register, data)

    def disarm_watchdogs(self) -> None:
        """Disarm all watchdogs, so that other programs may pause; not acknowledged.

        Raises:
            PortLost: the port is gone.
        """
        off = encode(Register.BUS_WATCHDOG, 0)
        armed = {servo: off for servo, found in self._found.items() if found.has_watchdog}
        if armed:
            self._bus.sync_write(Register.BUS_WATCHDOG, armed)

    def reachable(self, servo_id: int, ticks: int) -> int:
        """Return the goal nearest to a position that the servo can be sent to [ticks]."""
        lowest, highest = limits_of(self._servos, servo_id, self._found[servo_id])
        return max(lowest, min(highest, ticks))

    def _limit(self, servo_id: int, share: float) -> tuple[Register, int]:
        """Return the register that limits a servo's torque, and its value for a share of full duty.

        A stalled motor at a share of full duty draws that share of its stall current.
        """
        found = self._found[servo_id]
        if found.mode is OperatingMode.CURRENT_BASED_POSITION and found.current_limit_ma is not None:
            wanted = round(share * self._servos.models[servo_id].stall_current_ma)
            return Register.GOAL_CURRENT, min(wanted, found.current_limit_ma)
        return Register.GOAL_PWM, min(round(share * FULL_PWM), found.pwm_limit)

    def _check_position(self, servo_id: int, present_ticks: int) -> None:
        """Raise StartupError for a servo that must not be switched on at its position."""
        soft, own = self._soft[servo_id], limits_of(self._servos, servo_id, self._found[servo_id])
        inside = soft[0] - OUTSIDE_LIMIT_TICKS <= present_ticks <= soft[1] + OUTSIDE_LIMIT_TICKS
        # The servo refuses a goal beyond its own limits: it could not be told to stay there.
        jump = abs(self.reachable(servo_id, present_ticks) - present_ticks)
        if not inside or jump > TORQUE_ON_WITHIN_TICKS // 2:
            lowest, highest = soft if jump == 0 else own
            raise StartupError(
                f"joint {self._servos.by_id[servo_id].joint} stands at {present_ticks} ticks, outside {lowest} to "
                f"{highest}: bring it inside by hand, or check the calibration"
            )

    def _present(self, servo_id: int) -> Steps[int]:
        present = yield from read(self._bus, servo_id, Register.PRESENT_POSITION)
        return self._servos.calibrated_ticks(servo_id, present)

    def _await_rest(self, ids: Sequence[int]) -> Steps[None]:
        """Wait until the arm is at rest."""
        moving = -1
        for _ in range(REST_ATTEMPTS if ids else 0):
            readings: dict[int, list[int]] = {servo: [] for servo in ids}
            for _ in range(REST_READINGS):
                yield REST_INTERVAL_S
                size = len(encode(Register.PRESENT_POSITION, 0))
                for servo, frame in self._bus.sync_read(ids, Register.PRESENT_POSITION, size).items():
                    readings[servo].append(int.from_bytes(frame.data, "little", signed=True))
            moving = next((servo for servo, ticks in readings.items() if not _at_rest(ticks)), -1)
            if moving < 0:
                return
        if moving >= 0:
            raise StartupError(f"joint {self._servos.by_id[moving].joint} does not come to rest: let go of the arm")

    def _take_over(self, servo_id: int, goal_ticks: int) -> Steps[int]:
        """Set the profile of a servo that holds, and set it free if its watchdog has stopped it; return its goal."""
        if self._found[servo_id].has_watchdog:
            watchdog = yield from read(self._bus, servo_id, Register.BUS_WATCHDOG)
            if watchdog == WATCHDOG_TRIPPED:
                # It was stopped on its way, and must not go on to a goal that is long past.
                yield from write_verified(self._bus, servo_id, Register.BUS_WATCHDOG, 0)
                present = yield from self._present(servo_id)
                goal_ticks = yield from self._set_goal(servo_id, self.reachable(servo_id, present))
        yield from self._set_profile(servo_id)
        return goal_ticks

    def _switch_on(self, servo_id: int) -> Steps[int]:
        """Switch torque on at the present position and at reduced torque; return the goal [ticks]."""
        found = self._found[servo_id]
        if self._servos.by_id[servo_id].servo.gripper and found.current_limit_ma is not None:
            mode = OperatingMode.CURRENT_BASED_POSITION
            if found.mode is not mode:
                yield from write_verified(self._bus, servo_id, Register.OPERATING_MODE, mode)
                self._found[servo_id] = replace(found, mode=mode)
        if found.has_watchdog:
            yield from write_verified(self._bus, servo_id, Register.BUS_WATCHDOG, 0)
        yield from self._set_profile(servo_id)
        register, value = self._limit(servo_id, self._first_share(servo_id))
        yield from write_verified(self._bus, servo_id, register, value)
        goal = yield from self._set_goal(servo_id, self.reachable(servo_id, (yield from self._present(servo_id))))
        self._check_still(servo_id, (yield from self._present(servo_id)) - goal, "before")
        yield from write_verified(self._bus, servo_id, Register.TORQUE_ENABLE, 1)
        self._check_still(servo_id, (yield from self._present(servo_id)) - goal, "while")
        return (yield from self.goal(servo_id))

    def _set_profile(self, servo_id: int) -> Steps[None]:
        yield from write_verified(self._bus, servo_id, Register.PROFILE_ACCELERATION, PROFILE_ACCELERATION)
        velocity = self._servos.profile_velocity[servo_id]
        yield from write_verified(self._bus, servo_id, Register.PROFILE_VELOCITY, velocity)

    def _set_goal(self, servo_id: int, goal_ticks: int) -> Steps[int]:
        """Write a goal until it reads back; return it as read [ticks]."""
        for _ in range(STEP_ATTEMPTS):
            present = yield from read(self._bus, servo_id, Register.PRESENT_POSITION)
            turns = self._servos.turns_ticks(servo_id, present)
            yield 0.0
            with contextlib.suppress(NoReply):
                self._bus.write(servo_id, Register.GOAL_POSITION, goal_ticks - turns)
            taken = (yield from read(self._bus, servo_id, Register.GOAL_POSITION)) + turns
            if abs(taken - goal_ticks) <= GOAL_WITHIN_TICKS:
                return taken
        raise StartupError(f"servo {self._servos.label(servo_id)} does not take the goal {goal_ticks}")

    def _check_still(self, servo_id: int, moved_ticks: int, when: str) -> None:
        if abs(moved_ticks) > TORQUE_ON_WITHIN_TICKS:
            joint = self._servos.by_id[servo_id].joint
            raise StartupError(f"joint {joint} moved by {moved_ticks} ticks {when} torque came on; torque is off")

    def _first_share(self, servo_id: int) -> float:
        return min(FIRST_TORQUE, self._servos.full_share(servo_id))

    def _raise_torque(self, ids: Sequence[int], relaxed: Sequence[int]) -> Steps[None]:
        """Raise the torque limits from their present to their full values: those just switched on slowly."""
        full = {servo: self._servos.full_share(servo) for servo in ids}
        start = {servo: self._first_share(servo) for servo in relaxed if self._first_share(servo) < full[servo]}
        for step in range(1, RAISE_STEPS + 1 if start else 0):
            yield RAISE_S / RAISE_STEPS
            part = step / RAISE_STEPS
            self.write_limits({servo: share + (full[servo] - share) * part for servo, share in start.items()})
        for servo in ids:
            yield from write_verified(self._bus, servo, *self._limit(servo, full[servo]))

    def _arm_watchdog(self, servo_id: int) -> Steps[None]:
        if self._found[servo_id].has_watchdog:
            yield from write_verified(self._bus, servo_id, Register.BUS_WATCHDOG, WATCHDOG)

    def _switch_off_once(self, ids: Sequence[int]) -> Steps[list[int]]:
        driven = []
        for servo in ids:
            try:
                if (yield from self.is_on(servo)):
                    yield from write_verified(self._bus, servo, Register.TORQUE_ENABLE, 0)
            except (StartupError, NoReply):
                driven.append(servo)
        return driven


def _at_rest(ticks: Sequence[int]) -> bool:
    return len(ticks) > 1 and max(ticks) - min(ticks) <= REST_WITHIN_TICKS
