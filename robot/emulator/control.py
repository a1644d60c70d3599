"""Live commands to a running emulator, one JSON object a line.

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
``{"power_cycle": [3]}``           these start anew, with torque off and goal 0
``{"torque_off": [3]}``            torque goes off there, behind the driver's back
``{"powers_up_holding": [3]}``     from now on these power up with torque on, at the position where they are
``{"overload_latches": [3]}``      an overload of these is cleared by a power cycle only
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

Ticks are those of register PRESENT_POSITION. Every line is answered by ``{"ok": true}``, of "plugged" with the
port's name as ``port``, or by ``{"error": "..."}``. One object may hold several commands; none of them is carried out
unless all of them make sense.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping

from robot.emulator.commands import (
    FOR_SERVOS,
    NUMBERS,
    SWITCHES,
    VALUES,
    Emulation,
    Number,
    Value,
)
from robot.emulator.servo import Servo
from robot.emulator.servo_bus import ServoBus

Change = Callable[[Emulation], None]

PLUGGED_RENAMED = "renamed"


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


def check(command: Mapping[str, object], bus: ServoBus) -> list[Change]:
    """Check a command and return the changes that carry it out; nothing is changed yet.

    Raises:
        ValueError: there is no such command, or not with this value.
    """
    return [_change(name, value, bus) for name, value in command.items()]


def json_object(line: bytes) -> dict[str, object]:
    """Parse a line of JSON.

    Raises:
        ValueError: it is no JSON, or no object.
    """
    try:
        command = json.loads(line)
    except json.JSONDecodeError as error:
        raise ValueError(f"no JSON at column {error.colno}: {error.msg}") from error
    if not isinstance(command, dict):
        raise ValueError(f"a command is a JSON object, not {command!r}")  # noqa: TRY004 - refused input like the rest
    return command


def _line(reply: Mapping[str, object]) -> bytes:
    return json.dumps(reply).encode() + b"\n"


def _change(name: str, value: object, bus: ServoBus) -> Change:
    if name in NUMBERS:
        return _number(name, NUMBERS[name], value)
    if name in FOR_SERVOS:
        return _for_servos(name, value, bus)
    if name in VALUES:
        return _values(name, VALUES[name], value, bus)
    if name in SWITCHES:
        return _switch(name, value)
    if name == "plugged":
        return _plugged(value)
    known = [*NUMBERS, *FOR_SERVOS, *VALUES, *SWITCHES, "plugged"]
    raise ValueError(f"unknown command {name!r}; there are {', '.join(known)}")


def _number(name: str, number: Number, value: object) -> Change:
    checked = _checked(name, value, number.lowest, number.highest, number.meaning)
    return lambda emulation: number.put(emulation, checked)


def _for_servos(name: str, value: object, bus: ServoBus) -> Change:
    servos = {servo.servo_id: servo for servo in bus.servos}
    if not isinstance(value, list) or any(servo_id not in list(servos) for servo_id in value):
        raise ValueError(f"{name} takes a list of servo ids out of {list(servos)}, not {value!r}")

    def carry_out(emulation: Emulation) -> None:
        for servo_id in value:
            FOR_SERVOS[name](emulation, servos[servo_id])

    return carry_out


def _values(name: str, kind: Value, value: object, bus: ServoBus) -> Change:
    servos = {str(servo.servo_id): servo for servo in bus.servos}
    if not isinstance(value, dict) or any(servo_id not in servos for servo_id in value):
        raise ValueError(f"{name} takes an object with servo ids out of {list(servos)}, not {value!r}")
    changes = [_value(name, kind, servos[servo_id], one) for servo_id, one in value.items()]

    def carry_out(emulation: Emulation) -> None:
        for change in changes:
            change(emulation)

    return carry_out


def _value(name: str, kind: Value, servo: Servo, value: object) -> Change:
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
