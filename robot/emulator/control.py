"""Live commands to the emulated servos, one JSON object a line, and rehearsals: live commands at given times.

A script is a text file with one JSON object a line: live commands and their time
``at_s`` from the start of the script [s]. A line without a command only marks a time, such as the end of a pause::

    {"at_s": 0, "hand": {"3": 2047}}
    {"at_s": 2.5, "hand": {"3": null}, "push": {"2": 150}}
    {"at_s": 5, "push": {"2": 0}}
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from robot.calibration import MAX_TICK, Calibration, JointCalibration
from robot.emulator.faults import PROBABILITIES
from robot.emulator.feetech import FeetechServo
from robot.emulator.plant import HAND_TICKS_S
from robot.emulator.servo_bus import ServoBus
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import StatusFlag

# For people who call for help at the command line.
COMMANDS_HELP = """\
Live commands to a running emulator, one JSON object a line.

================================== ====================================================================================
``{"drop": 0.01}``                 probability that a reply is lost
``{"corrupt": 0.05}``              ... that one byte of a reply is wrong
``{"wrong_id": 0.01}``             ... that a reply bears another id, with a sound checksum
``{"truncate": 0.01}``             ... that a reply is cut short
``{"duplicate": 0.01}``            ... that a reply comes twice
``{"noise": 0.01}``                ... that noise comes before a reply
``{"delay": 0.01}``                ... that the host gets a reply, and those behind it, later
``{"delay_s": 0.02}``              by how much later [s]
``{"lose_instruction": 0.01}``     probability that no servo hears an instruction
``{"offline": [3]}``               these servos neither hear nor speak
``{"online": [3]}``                these do again
``{"unplug": ["gripper", 5]}``     the cables of these, by joint or number in the chain, are pulled: they lose power
``{"plug": ["gripper"]}``          these are plugged in again, and start anew
``{"power_cycle": [3]}``           these start anew, with torque off and goal 0
``{"torque_off": [3]}``            torque goes off there, behind the driver's back
``{"powers_up_holding": [3]}``     from now on these power up with torque on, at the position where they are
``{"overload_latches": [3]}``      an overload of these is cleared by a power cycle only; until then torque stays on
``{"mirror": ["gripper"]}``        the horns of these are mounted mirrored, or as before
``{"obstacle": {"3": 2100}}``      something in the way of the joint at this tick; null takes it away
``{"push": {"3": 150}}``           a push on the joint, in the motor's duty that would do the same [0.1 %]; 0 ends it
``{"hand": {"3": 1900}}``          a hand takes the joint to this tick, whatever the motor does; null lets go
``{"jump": {"3": 400}}``           the joint is at once so many ticks from where it was
``{"temperature": {"3": 66}}``     temperature of the motor, from where it warms or cools on [degC]
``{"voltage": {"3": 4.2}}``        supply of the servo [V]
``{"supply": 4.2}``                supply of all servos [V]
``{"status": {"3": 2}}``           complaints forced on the servo, bits of register STATUS; 0 takes them back
``{"heat_rate": 100}``             how much faster than life motors warm and cool
``{"stall_behind_missing": true}`` a sync read ends at the first servo that does not answer
``{"usb_frame_ms": 1}``            replies come at multiples of this time [ms]; 0 for at once
``{"frozen": true}``               the adapter neither takes nor gives bytes; what comes meanwhile waits
``{"plugged": false}``             the adapter is pulled: port and link are gone
``{"plugged": true}``              it is back, under its own name if that is free
``{"plugged": "renamed"}``         it is back under another name; ``--link`` stays the same
================================== ====================================================================================

Ticks are those of register PRESENT_POSITION. A joint's name may stand for a servo's id, such as where several have the
same one. Every line is answered by ``{"ok": true}``, of "plugged" with the port's name as ``port``, or by
``{"error": "..."}``. One object may hold several commands; none of them is carried out unless all of them make sense.
"""

# A controller that sends more bytes than this without a line end is disconnected; a command is short.
MAX_COMMAND_BYTES = 64 << 10

# Full duty of the motor.
MAX_PUSH_PERMILLE = 1000

# Greatest values of registers PRESENT_TEMPERATURE and PRESENT_VOLTAGE.
MAX_TEMPERATURE_C = 255
MAX_VOLTAGE_V = 25.5

MAX_STATUS = 255

# Longer than anything waits for a reply.
MAX_DELAY_S = 10.0

# FTDI's adapters delay bytes by 16 ms.
MAX_USB_FRAME_MS = 100

# An hour of heating in a second.
MAX_HEAT_RATE = 3600

PLUGGED_RENAMED = "renamed"


class Adapter(Protocol):
    """USB adapter, as far as commands change it.

    Attributes:
        port: name of the port.
        frozen: True while it neither takes nor delivers bytes.
        frame_s: interval at multiples of which replies are delivered [s]; 0 delivers them at once.
    """

    port: str
    frozen: bool
    frame_s: float

    def plug_in(self, *, renamed: bool = False) -> None:
        """Create the port, under another name if ``renamed``, unless it is there."""

    def unplug(self) -> None:
        """Remove the port."""


@dataclass(frozen=True)
class Emulation:
    """FeetechServo bus and adapter, the targets of commands."""

    bus: ServoBus[FeetechServo]
    adapter: Adapter


Change = Callable[[Emulation], None]


def answer(line: bytes, emulation: Emulation) -> bytes:
    """Carry out one line of commands and return the line that answers it."""
    try:
        command = json_object(line)
        changes = check(command, emulation.bus)
    except ValueError as error:
        return _line({"error": str(error)})
    for change in changes:
        change(emulation)
    emulation.bus.record_command(command)
    return _line({"ok": True, "port": emulation.adapter.port} if "plugged" in command else {"ok": True})


def check(command: Mapping[str, object], bus: ServoBus[FeetechServo]) -> list[Change]:
    """Check a command and return the changes that carry it out; nothing is changed yet.

    Raises:
        ValueError: there is no such command, or not with this value.
    """
    return [_change(name, value, bus) for name, value in command.items()]


def json_object(line: bytes) -> dict[str, object]:
    """Parse a line of JSON.

    Raises:
        ValueError: it is not a JSON object.
    """
    try:
        command = json.loads(line)
    except json.JSONDecodeError as error:
        raise ValueError(f"no JSON at column {error.colno}: {error.msg}") from error
    if not isinstance(command, dict):
        raise ValueError(f"a command is a JSON object, not {command!r}")  # noqa: TRY004 - refused input like the rest
    return command


@dataclass(frozen=True)
class Number:
    """Command that takes a number for the whole emulation.

    Attributes:
        lowest: least value.
        highest: greatest value.
        put: applies the value.
        meaning: noun for the value in errors.
    """

    lowest: float
    highest: float
    put: Callable[[Emulation, float], None]
    meaning: str = "a number"


@dataclass(frozen=True)
class Value:
    """Command that takes a number for single servos.

    Attributes:
        lowest: least value.
        highest: greatest value.
        put: applies the value.
        end: applies null; None where null is no value.
    """

    lowest: float
    highest: float
    put: Callable[[FeetechServo, float], None]
    end: Callable[[FeetechServo], None] | None = None


def _probability(name: str) -> Number:
    return Number(0.0, 1.0, lambda emulation, value: setattr(emulation.bus.faults, name, value), "a probability")


def _supply(emulation: Emulation, voltage_v: float) -> None:
    for servo in emulation.bus.servos:
        servo.voltage_v = voltage_v


def _heat_rate(emulation: Emulation, rate: float) -> None:
    for servo in emulation.bus.servos:
        servo.motor.rate = rate


def _delay(emulation: Emulation, delay_s: float) -> None:
    emulation.bus.faults.delay_s = delay_s


def _usb_frame(emulation: Emulation, frame_ms: float) -> None:
    emulation.adapter.frame_s = frame_ms / 1000.0


NUMBERS: Mapping[str, Number] = MappingProxyType(
    {
        **{name: _probability(name) for name in PROBABILITIES},
        "delay_s": Number(0.0, MAX_DELAY_S, _delay),
        "supply": Number(0.0, MAX_VOLTAGE_V, _supply),
        "heat_rate": Number(0.0, MAX_HEAT_RATE, _heat_rate),
        "usb_frame_ms": Number(0.0, MAX_USB_FRAME_MS, _usb_frame),
    }
)


def _torque_off(_emulation: Emulation, servo: FeetechServo) -> None:
    servo.write(Register.TORQUE_ENABLE, bytes([0]))


def _powers_up_holding(_emulation: Emulation, servo: FeetechServo) -> None:
    servo.powers_up_holding = True


def _overload_latches(_emulation: Emulation, servo: FeetechServo) -> None:
    servo.protection.latches = True


FOR_SERVOS: Mapping[str, Callable[[Emulation, FeetechServo], None]] = MappingProxyType(
    {
        "offline": lambda emulation, servo: emulation.bus.faults.offline.add(servo.servo_id),
        "online": lambda emulation, servo: emulation.bus.faults.offline.discard(servo.servo_id),
        "power_cycle": lambda _emulation, servo: servo.power_up(),
        "torque_off": _torque_off,
        "powers_up_holding": _powers_up_holding,
        "overload_latches": _overload_latches,
        "mirror": lambda _emulation, servo: servo.mirror(),
    }
)


def _obstacle(servo: FeetechServo, ticks: float) -> None:
    servo.plant.block(servo.encoder_ticks(ticks))


def _push(servo: FeetechServo, push_permille: float) -> None:
    servo.plant.push_permille = push_permille


def _hand(servo: FeetechServo, ticks: float) -> None:
    servo.plant.hand_ticks = servo.encoder_ticks(ticks)


def _let_go(servo: FeetechServo) -> None:
    servo.plant.hand_ticks = None


def _jump(servo: FeetechServo, ticks: float) -> None:
    servo.plant.position_ticks += ticks


def _temperature(servo: FeetechServo, temperature_c: float) -> None:
    servo.motor.temperature_c = temperature_c


def _voltage(servo: FeetechServo, voltage_v: float) -> None:
    servo.voltage_v = voltage_v


def _status(servo: FeetechServo, status: float) -> None:
    servo.protection.forced = StatusFlag(int(status))


VALUES: Mapping[str, Value] = MappingProxyType(
    {
        "obstacle": Value(0, MAX_TICK, _obstacle, lambda servo: servo.plant.block(None)),
        "push": Value(-MAX_PUSH_PERMILLE, MAX_PUSH_PERMILLE, _push),
        "hand": Value(0, MAX_TICK, _hand, _let_go),
        "jump": Value(-MAX_TICK, MAX_TICK, _jump),
        "temperature": Value(0, MAX_TEMPERATURE_C, _temperature),
        "voltage": Value(0, MAX_VOLTAGE_V, _voltage),
        "status": Value(0, MAX_STATUS, _status),
    }
)


PLUGS: Mapping[str, Callable[[FeetechServo], None]] = MappingProxyType(
    {"plug": FeetechServo.plug_in, "unplug": FeetechServo.unplug}
)


def _stall_behind_missing(emulation: Emulation, on: bool) -> None:
    emulation.bus.faults.stall_behind_missing = on


def _frozen(emulation: Emulation, on: bool) -> None:
    emulation.adapter.frozen = on


SWITCHES: Mapping[str, Callable[[Emulation, bool], None]] = MappingProxyType(
    {"stall_behind_missing": _stall_behind_missing, "frozen": _frozen}
)


def _change(name: str, value: object, bus: ServoBus[FeetechServo]) -> Change:
    if name in NUMBERS:
        return _number(name, NUMBERS[name], value)
    if name in FOR_SERVOS:
        return _for_servos(name, value, bus)
    if name in PLUGS:
        return _plugs(name, value, bus)
    if name in VALUES:
        return _values(name, VALUES[name], value, bus)
    if name in SWITCHES:
        return _switch(name, value)
    if name == "plugged":
        return _plugged(value)
    known = [*NUMBERS, *FOR_SERVOS, *PLUGS, *VALUES, *SWITCHES, "plugged"]
    raise ValueError(f"unknown command {name!r}; there are {', '.join(known)}")


def _number(name: str, number: Number, value: object) -> Change:
    checked = _checked(name, value, number.lowest, number.highest, number.meaning)
    return lambda emulation: number.put(emulation, checked)


def _for_servos(name: str, value: object, bus: ServoBus[FeetechServo]) -> Change:
    servos: dict[object, FeetechServo] = {servo.servo_id: servo for servo in bus.servos}
    listed = _listed(name, value, servos | _by_joint(bus), f"servo ids out of {list(servos)}")

    def carry_out(emulation: Emulation) -> None:
        """Apply the checked command."""
        for servo in listed:
            FOR_SERVOS[name](emulation, servo)

    return carry_out


def _plugs(name: str, value: object, bus: ServoBus[FeetechServo]) -> Change:
    chain: dict[object, FeetechServo] = dict(enumerate(bus.servos, start=1))
    listed = _listed(name, value, chain | _by_joint(bus), f"joints or their numbers in the chain, 1 to {len(chain)}")

    def carry_out(_emulation: Emulation) -> None:
        """Apply the checked command."""
        for servo in listed:
            PLUGS[name](servo)

    return carry_out


def _by_joint(bus: ServoBus[FeetechServo]) -> dict[object, FeetechServo]:
    return {servo.joint: servo for servo in bus.servos}


def _listed(name: str, value: object, servos: Mapping[object, FeetechServo], names: str) -> list[FeetechServo]:
    if not isinstance(value, list) or any(one not in list(servos) for one in value):
        raise ValueError(f"{name} takes a list of {names}, not {value!r}")
    return [servos[one] for one in value]


def _values(name: str, kind: Value, value: object, bus: ServoBus[FeetechServo]) -> Change:
    ids: dict[object, FeetechServo] = {str(servo.servo_id): servo for servo in bus.servos}
    servos = ids | _by_joint(bus)
    if not isinstance(value, dict) or any(named not in servos for named in value):
        raise ValueError(f"{name} takes an object with servo ids out of {list(ids)}, not {value!r}")
    changes = [_value(name, kind, servos[named], one) for named, one in value.items()]

    def carry_out(emulation: Emulation) -> None:
        """Apply the checked command."""
        for change in changes:
            change(emulation)

    return carry_out


def _value(name: str, kind: Value, servo: FeetechServo, value: object) -> Change:
    end = kind.end
    if value is None and end is not None:
        return lambda _emulation: end(servo)
    checked = _checked(name, value, kind.lowest, kind.highest, "a number")
    return lambda _emulation: kind.put(servo, checked)


def _switch(name: str, value: object) -> Change:
    if not isinstance(value, bool):
        raise ValueError(f"{name} is true or false, not {value!r}")  # noqa: TRY004 - refused input like the rest
    return lambda emulation: SWITCHES[name](emulation, value)


def _plugged(value: object) -> Change:
    if not isinstance(value, bool) and value != PLUGGED_RENAMED:
        raise ValueError(f"plugged is true, false or {PLUGGED_RENAMED!r}, not {value!r}")
    if value is False:
        return lambda emulation: emulation.adapter.unplug()
    return lambda emulation: emulation.adapter.plug_in(renamed=value == PLUGGED_RENAMED)


def _checked(name: str, value: object, lowest: float, highest: float, meaning: str) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not lowest <= value <= highest:
        raise ValueError(f"{name} is {meaning} from {lowest:g} to {highest:g}, not {value!r}")
    return float(value)


def _line(reply: Mapping[str, object]) -> bytes:
    return json.dumps(reply).encode() + b"\n"


# A day; a later time is likely a mistaken unit.
MAX_AT_S = 86_400.0

# Shortest duration of a repeated script [s]: a shorter one would keep the loop that plays it busy.
MIN_REPEATED_S = 0.1

# Time from the host's first byte to the first event of a ready-made rehearsal: a person reads the question of
# `armbridge calibrate` and presses Enter, a server takes the arm over.
LEAD_S = 10.0

# A hand rests at each end, so that readings every 20 ms see the joint there even when the machine is busy.
REST_S = 1.0

# Most of the load that the default torque limit (800) can hold; the position loop gives way by 30 ticks.
PUSH_PERMILLE = 500
PUSH_S = 5.0

# The obstacle stands by this share of the joint's range above its middle: 0.17 rad at the SO-101's elbow, which the
# named target `ready` moves by 0.5 rad.
OBSTACLE_SHARE = 0.05

# Time to send a goal and see it fail.
OBSTACLE_S = 30.0


@dataclass(frozen=True)
class TimedCommand:
    """Live command with a time.

    Attributes:
        at_s: time from the start of the script [s].
        command: command for :func:`robot.emulator.control.check`.
    """

    at_s: float
    command: Mapping[str, object]


class Rehearsal:
    """Schedule of timed commands.

    Args:
        commands: in the order of their times; may be empty.
        repeats: True to start again after the last command.

    Raises:
        ValueError: they are to be repeated, but shorter than :data:`MIN_REPEATED_S`.
    """

    def __init__(self, commands: Sequence[TimedCommand] = (), *, repeats: bool = False) -> None:
        if repeats and (not commands or commands[-1].at_s < MIN_REPEATED_S):
            last = f"it is {commands[-1].at_s:g}" if commands else "there is none"
            raise ValueError(f"a script is repeated only if its last at_s is {MIN_REPEATED_S:g} or more; {last}")
        self.commands = tuple(commands)
        self._repeats = repeats
        self._start_s: float | None = None
        self._next = 0

    def start(self, now_s: float) -> None:
        """Start at a monotonic time [s], unless it has started."""
        if self._start_s is None:
            self._start_s = now_s

    def commands_due(self, now_s: float) -> list[TimedCommand]:
        """Return the commands that have become due since the last call, each once in a round.

        A round ends with its last command, and the next one starts when that is noticed.
        """
        due: list[TimedCommand] = []
        if self._start_s is None:
            return due
        while self._next < len(self.commands) and self.commands[self._next].at_s <= now_s - self._start_s:
            due.append(self.commands[self._next])
            self._next += 1
        if self._repeats and self._next == len(self.commands):
            self._start_s, self._next = now_s, 0
        return due


def read_script(path: Path, bus: ServoBus[FeetechServo]) -> tuple[TimedCommand, ...]:
    """Read a script and check all of its commands.

    Args:
        path: the file.
        bus: servo bus that its commands may change.

    Raises:
        OSError: the file cannot be read.
        ValueError: a line is not a command with a time later than the line before; the text names file and line.
    """
    commands: list[TimedCommand] = []
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        if not line.strip():
            continue
        try:
            commands.append(_timed_command(line, commands[-1].at_s if commands else None, bus))
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from error
    if not commands:
        raise ValueError(f"{path}: the script has no commands")
    return tuple(commands)


def _timed_command(line: bytes, previous_s: float | None, bus: ServoBus[FeetechServo]) -> TimedCommand:
    command = json_object(line)
    if "at_s" not in command:
        raise ValueError(f"at_s is missing, a number from 0 to {MAX_AT_S:g}")
    at_s = command.pop("at_s")
    if not isinstance(at_s, int | float) or isinstance(at_s, bool) or not 0.0 <= at_s <= MAX_AT_S:
        raise ValueError(f"at_s is a number from 0 to {MAX_AT_S:g}, not {at_s!r}")
    if previous_s is not None and at_s <= previous_s:
        raise ValueError(f"at_s is more than the {previous_s:g} of the command before, not {at_s!r}")
    check(command, bus)
    return TimedCommand(float(at_s), command)


def sweep(calibration: Calibration) -> tuple[TimedCommand, ...]:
    """Move the arm by hand to its middle pose, then every joint from stop to stop and back, as for ``calibrate``.

    The joint that turns freely stays in the middle.
    """
    joints = calibration.joints
    swept = [joint for joint in joints if not joint.servo.turns_freely]
    across_s = max(joint.range_max - joint.range_min for joint in swept) / HAND_TICKS_S
    at_lower_s = LEAD_S + across_s / 2.0 + REST_S
    at_upper_s = at_lower_s + across_s + REST_S
    in_middle_s = at_upper_s + across_s / 2.0 + REST_S
    return (
        TimedCommand(0.0, _hand_motion({joint: _middle_ticks(joint) for joint in joints})),
        TimedCommand(LEAD_S, _hand_motion({joint: joint.range_min for joint in swept})),
        TimedCommand(at_lower_s, _hand_motion({joint: joint.range_max for joint in swept})),
        TimedCommand(at_upper_s, _hand_motion({joint: _middle_ticks(joint) for joint in swept})),
        TimedCommand(in_middle_s, _hand_motion(dict.fromkeys(joints))),
    )


def push(calibration: Calibration) -> tuple[TimedCommand, ...]:
    """Push the joint halfway along the arm, and let go."""
    servo_id = str(_halfway_along(calibration).servo_id)
    return (
        TimedCommand(LEAD_S, {"push": {servo_id: PUSH_PERMILLE}}),
        TimedCommand(LEAD_S + PUSH_S, {"push": {servo_id: 0}}),
    )


def stall(calibration: Calibration) -> tuple[TimedCommand, ...]:
    """Put an obstacle above the middle of the joint halfway along the arm, and take it away."""
    joint = _halfway_along(calibration)
    obstacle = _middle_ticks(joint) + round(OBSTACLE_SHARE * (joint.range_max - joint.range_min))
    return (
        TimedCommand(LEAD_S, {"obstacle": {str(joint.servo_id): obstacle}}),
        TimedCommand(LEAD_S + OBSTACLE_S, {"obstacle": {str(joint.servo_id): None}}),
    )


REHEARSALS: Mapping[str, Callable[[Calibration], tuple[TimedCommand, ...]]] = MappingProxyType(
    {"sweep": sweep, "push": push, "stall": stall}
)


def _hand_motion(ticks: Mapping[JointCalibration, int | None]) -> dict[str, object]:
    return {"hand": {str(joint.servo_id): target for joint, target in ticks.items()}}


def _middle_ticks(joint: JointCalibration) -> int:
    return (joint.range_min + joint.range_max) // 2


def _halfway_along(calibration: Calibration) -> JointCalibration:
    return calibration.joints[(len(calibration.joints) - 1) // 2]
