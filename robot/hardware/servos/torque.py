"""Switching the servos' torque on without a jump, off without a fall, and off at once.

Torque on with a stale goal strips gears: the goal is set to the present position and read back before torque comes on,
with the torque limited and then raised slowly. An arm that is already holding keeps its goals. Every public operation
is a sequence (:mod:`robot.hardware.interface`) that may be abandoned between any two of its steps. Positions are as the
calibration counts (:mod:`robot.hardware.servos.family`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from robot.errors import NoReply, StartupError
from robot.hardware.interface import Steps
from robot.hardware.servos.bus import STEP_ATTEMPTS, ServoBus, read, write_verified
from robot.hardware.servos.family import Limit, ServoFamily, ServoMap
from robot.hardware.servos.registers import RegisterEnum

# Largest distance from the goal when torque comes on; more means that the arm moved or the goal was not taken.
TORQUE_ON_WITHIN_TICKS = 30

OUTSIDE_LIMIT_TICKS = 100  # further outside its soft limits than this (9 deg) an arm is not switched on

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


def relax(bus: ServoBus, ids: Sequence[int], start: Mapping[int, Limit], full: Mapping[int, Limit]) -> Steps[list[int]]:
    """Lower torque limits by id, switch torque off, and leave full limits; return servos that may be driven."""
    for left in reversed(range(LOWER_STEPS)):
        yield LOWER_S / LOWER_STEPS
        lowered = {servo: Limit(register, value * left // LOWER_STEPS) for servo, (register, value) in start.items()}
        write_limits(bus, lowered)
    driven = yield from switch_off(bus, ids)
    if not driven:
        write_limits(bus, full)
    return driven


def emergency_stop(bus: ServoBus, ids: Sequence[int]) -> Steps[list[int]]:
    """Switch torque off everywhere with the first step, then verify it; return servos that may still be driven."""
    for _ in range(BROADCASTS):
        bus.broadcast_torque_off()
        yield BROADCAST_INTERVAL_S
    return (yield from switch_off(bus, ids))


def switch_off(bus: ServoBus, ids: Sequence[int]) -> Steps[list[int]]:
    """Switch torque off servo by servo, and verify that; return the servos that may still be driven."""
    driven = yield from _switch_off_once(bus, ids)
    for _ in range(OFF_ROUNDS - 1):
        if not driven:
            break
        yield OFF_INTERVAL_S
        driven = yield from _switch_off_once(bus, driven)
    return driven


def write_limits(bus: ServoBus, limits: Mapping[int, Limit]) -> None:
    """Write torque limits by servo id, which are not acknowledged, in one packet a register."""
    blocks: dict[RegisterEnum, dict[int, bytes]] = {}
    for servo, (register, value) in limits.items():
        blocks.setdefault(register, {})[servo] = register.encode(value)
    for register, data in blocks.items():
        bus.sync_write(register, data)


class ServoTorque:
    """Torque of an arm's servos, from their survey on."""

    def __init__(self, family: ServoFamily, bus: ServoBus, servos: ServoMap) -> None:
        self._family = family
        self._bus = bus
        self._servos = servos

    def enable(self, ids: Sequence[int]) -> Steps[dict[int, int]]:
        """Switch servos on at their positions; the others are only read.

        Return the goals of all servos, positions for those that do not hold, by id [ticks]. After StartupError (the arm
        moves, stands outside its limits, or does not take a value) and NoReply servos relaxed before are relaxed again.
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
        # Where relaxing was broken off the arm has sunk, and must not rise to its goals by itself.
        full, limits = self.full_limits(), (yield from self._other_limits(holding))
        sunk = all(limits.get(servo, full[servo].value) < full[servo].value for servo in holding)
        for servo in holding:
            goals[servo] = yield from self._take_over(servo, goals[servo], stopped=sunk)
        try:
            yield from self._await_rest(relaxed)
            for servo in relaxed:
                goals[servo] = yield from self._switch_on(servo)
            yield from self._raise_torque(ids)
            for servo in ids:
                yield from self._arm_watchdog(servo)
        except (StartupError, NoReply) as error:
            left = yield from switch_off(self._bus, relaxed)
            if left:
                names = ", ".join(self._servos.label(servo) for servo in left)
                raise StartupError(f"{error}; torque off could not be verified at {names}") from error
            raise
        return goals

    def clear_error(self, servo_id: int, *, hold: bool) -> Steps[None]:
        """Clear a servo's latched error; then it holds, or is off. Raises StartupError if it moves, and NoReply."""
        yield from self._family.clear_error(self._bus, self._servos.by_id[servo_id])
        if hold or self._family.torque_on_clears_errors:
            yield from self._switch_on(servo_id)
        if hold:
            yield from self._raise_torque([servo_id])
            yield from self._arm_watchdog(servo_id)
        elif (yield from switch_off(self._bus, [servo_id])):
            raise StartupError(f"torque off could not be verified at {self._servos.label(servo_id)}")

    def is_on(self, servo_id: int) -> Steps[bool]:
        """Read a servo's TORQUE_ENABLE; raises NoReply."""
        return (yield from read(self._bus, servo_id, self._bus.registers.torque_enable)) == 1

    def goal(self, servo_id: int) -> Steps[int]:
        """Read a servo's goal [ticks]; raises NoReply."""
        turns = yield from self._turns(servo_id)
        return (yield from read(self._bus, servo_id, self._bus.registers.goal_position)) + turns

    def limits(self, shares: Mapping[int, float]) -> dict[int, Limit]:
        """Convert shares of full duty to torque limits, by servo id."""
        return {servo: self._limit(servo, share) for servo, share in shares.items()}

    def full_limits(self) -> dict[int, Limit]:
        return self.limits(self._servos.by_servo(self._servos.full_torque))

    def disarm_watchdogs(self) -> None:
        """Disarm all watchdogs, so that other programs may pause; not acknowledged."""
        watchdog = self._family.watchdog
        if watchdog is not None:
            armed = {servo: Limit(watchdog.register, 0) for servo in self._servos.found if self.has_watchdog(servo)}
            write_limits(self._bus, armed)

    def has_watchdog(self, servo_id: int) -> bool:
        """Return True for a servo that was surveyed and has a watchdog."""
        found = self._servos.found.get(servo_id)
        return found is not None and self._family.has_watchdog(self._servos.by_id[servo_id], found.values)

    def goal_limits_ticks(self, servo_id: int) -> tuple[int, int]:
        values, certain_ticks = self._servos.found[servo_id].values, self._servos.certain_ticks(servo_id)
        return self._family.goal_limits_ticks(values, certain_ticks)

    def reachable(self, servo_id: int, ticks: int) -> int:
        """Return the goal nearest to a position that the servo can be sent to [ticks]."""
        lowest, highest = self.goal_limits_ticks(servo_id)
        return max(lowest, min(highest, ticks))

    def _limit(self, servo_id: int, share: float) -> Limit:
        return self._family.limit(self._servos.by_id[servo_id], self._servos.found[servo_id].values, share)

    def _check_position(self, servo_id: int, present_ticks: int) -> None:
        soft, own = self._servos.soft_limits_ticks[servo_id], self.goal_limits_ticks(servo_id)
        inside = soft[0] - OUTSIDE_LIMIT_TICKS <= present_ticks <= soft[1] + OUTSIDE_LIMIT_TICKS
        # The servo clamps or refuses a goal beyond its own limits: torque would move it, or it could not stay there.
        jump = abs(self.reachable(servo_id, present_ticks) - present_ticks)
        if not inside or jump > TORQUE_ON_WITHIN_TICKS // 2:
            lowest, highest = soft if jump == 0 else own
            raise StartupError(
                f"joint {self._servos.by_id[servo_id].joint} stands at {present_ticks} ticks, outside {lowest} to "
                f"{highest}: bring it inside by hand, or check the calibration"
            )

    def _turns(self, servo_id: int) -> Steps[int]:
        if not self._family.counts_turns:
            return 0
        present = yield from read(self._bus, servo_id, self._bus.registers.present_position)
        return self._servos.turns_ticks(servo_id, present)

    def _present(self, servo_id: int) -> Steps[int]:
        present = yield from read(self._bus, servo_id, self._bus.registers.present_position)
        return present + self._servos.turns_ticks(servo_id, present)

    def _await_rest(self, ids: Sequence[int]) -> Steps[None]:
        table = self._bus.registers
        position = table.block(table.present_position)
        moving = -1
        for _ in range(REST_ATTEMPTS if ids else 0):
            readings: dict[int, list[int]] = {servo: [] for servo in ids}
            for _ in range(REST_READINGS):
                yield REST_INTERVAL_S
                for servo, frame in self._bus.sync_read(ids, position.address, position.length).items():
                    readings[servo].append(table.present_position.decode(frame.data))
            moving = next((servo for servo, ticks in readings.items() if not _at_rest(ticks)), -1)
            if moving < 0:
                return
        if moving >= 0:
            raise StartupError(f"joint {self._servos.by_id[moving].joint} does not come to rest: let go of the arm")

    def _take_over(self, servo_id: int, goal_ticks: int, *, stopped: bool) -> Steps[int]:
        """Set the profile of a servo that holds; return its goal, the present position if it was stopped on its way."""
        watchdog = self._family.watchdog
        if watchdog is not None and self.has_watchdog(servo_id):
            state = yield from read(self._bus, servo_id, watchdog.register)
            if state == watchdog.tripped:
                yield from write_verified(self._bus, servo_id, watchdog.register, 0)
                stopped = True
        if stopped:
            # It must not go on to a goal that is long past.
            present = yield from self._present(servo_id)
            goal_ticks = yield from self._set_goal(servo_id, self.reachable(servo_id, present))
        yield from self._set_profile(servo_id)
        return goal_ticks

    def _switch_on(self, servo_id: int) -> Steps[int]:
        found, watchdog = self._servos.found[servo_id], self._family.watchdog
        values = yield from self._family.prepare(self._bus, self._servos.by_id[servo_id], found.values)
        self._servos.found[servo_id] = replace(found, values=values)
        if watchdog is not None and self.has_watchdog(servo_id):
            yield from write_verified(self._bus, servo_id, watchdog.register, 0)
        yield from self._set_profile(servo_id)
        share = min(FIRST_TORQUE, self._servos.by_servo(self._servos.full_torque)[servo_id])
        yield from write_verified(self._bus, servo_id, *self._limit(servo_id, share))
        goal = yield from self._set_goal(servo_id, self.reachable(servo_id, (yield from self._present(servo_id))))
        self._check_still(servo_id, (yield from self._present(servo_id)) - goal, "before")
        yield from write_verified(self._bus, servo_id, self._bus.registers.torque_enable, 1)
        self._check_still(servo_id, (yield from self._present(servo_id)) - goal, "while")
        return (yield from self.goal(servo_id))

    def _set_profile(self, servo_id: int) -> Steps[None]:
        for register, value in self._family.profile(self._servos.speed_ticks_s[servo_id]).items():
            yield from write_verified(self._bus, servo_id, register, value)

    def _set_goal(self, servo_id: int, goal_ticks: int) -> Steps[int]:
        for _ in range(STEP_ATTEMPTS):
            turns = yield from self._turns(servo_id)
            block = self._servos.goal_block(servo_id, goal_ticks - turns)
            yield 0.0
            self._bus.sync_write(self._family.goal_address, {servo_id: block})
            taken = (yield from read(self._bus, servo_id, self._bus.registers.goal_position)) + turns
            if abs(taken - goal_ticks) <= self._family.goal_within_ticks:
                return taken
        raise StartupError(f"servo {self._servos.label(servo_id)} does not take the goal {goal_ticks}")

    def _check_still(self, servo_id: int, moved_ticks: int, when: str) -> None:
        if abs(moved_ticks) > TORQUE_ON_WITHIN_TICKS:
            joint = self._servos.by_id[servo_id].joint
            raise StartupError(f"joint {joint} moved by {moved_ticks} ticks {when} torque came on; torque is off")

    def _other_limits(self, ids: Sequence[int]) -> Steps[dict[int, int]]:
        """Read torque limits, and return those that are not the full ones, by id."""
        full, others = self.full_limits(), {}
        for servo in ids:
            value = yield from read(self._bus, servo, full[servo].register)
            if value != full[servo].value:
                others[servo] = value
        return others

    def _raise_torque(self, ids: Sequence[int]) -> Steps[None]:
        full, start = self.full_limits(), (yield from self._other_limits(ids))
        for step in range(1, RAISE_STEPS + 1 if start else 0):
            yield RAISE_S / RAISE_STEPS
            limits = {
                servo: Limit(full[servo].register, value + (full[servo].value - value) * step // RAISE_STEPS)
                for servo, value in start.items()
            }
            write_limits(self._bus, limits)
        for servo in start:
            yield from write_verified(self._bus, servo, *full[servo])

    def _arm_watchdog(self, servo_id: int) -> Steps[None]:
        watchdog = self._family.watchdog
        if watchdog is not None and self.has_watchdog(servo_id):
            yield from write_verified(self._bus, servo_id, watchdog.register, watchdog.armed)


def _switch_off_once(bus: ServoBus, ids: Sequence[int]) -> Steps[list[int]]:
    driven = []
    for servo in ids:
        try:
            if (yield from read(bus, servo, bus.registers.torque_enable)) != 0:
                yield from write_verified(bus, servo, bus.registers.torque_enable, 0)
        except (StartupError, NoReply):
            driven.append(servo)
    return driven


def _at_rest(ticks: Sequence[int]) -> bool:
    return len(ticks) > 1 and max(ticks) - min(ticks) <= REST_WITHIN_TICKS
