"""Live commands to a running emulator, one JSON object a line.

========================== ==================================================
``{"drop": 0.01}``         probability that a reply is lost
``{"corrupt": 0.05}``      probability that one byte of a reply is wrong
``{"offline": [3]}``       these servos neither hear nor speak
``{"online": [3]}``        these do again
``{"power_cycle": [3]}``   these start anew, with torque off
========================== ==================================================

Every line is answered by ``{"ok": true}`` or ``{"error": "..."}``. One object may hold several commands; none
of them is carried out unless all of them make sense.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping

from robot.emulator.wire import ServoBus

Change = Callable[[], None]


def answer(line: bytes, bus: ServoBus) -> bytes:
    """Carry out one line of commands and return the line that answers it."""
    try:
        changes = [_change(name, value, bus) for name, value in _object(line).items()]
    except ValueError as error:
        return json.dumps({"error": str(error)}).encode() + b"\n"
    for change in changes:
        change()
    return b'{"ok": true}\n'


def _object(line: bytes) -> dict[str, object]:
    command = json.loads(line)
    if not isinstance(command, dict):
        raise ValueError(f"a command is a JSON object, not {command!r}")  # noqa: TRY004 - refused input like the rest
    return command


def _change(name: str, value: object, bus: ServoBus) -> Change:
    """Check one command and return what carries it out.

    Raises:
        ValueError: there is no such command, or not with this value.
    """
    faults = bus.faults
    if name in ("drop", "corrupt"):
        probability = _probability(name, value)
        return lambda: setattr(faults, name, probability)
    by_name: Mapping[str, Callable[[set[int]], None]] = {
        "offline": faults.offline.update,
        "online": faults.offline.difference_update,
        "power_cycle": lambda ids: _power_cycle(bus, ids),
    }
    if name not in by_name:
        raise ValueError(f"unknown command {name!r}; there are drop, corrupt, {', '.join(by_name)}")
    ids = _servo_ids(name, value, bus)
    return lambda: by_name[name](ids)


def _probability(name: str, value: object) -> float:
    if not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise ValueError(f"{name} is a probability from 0 to 1, not {value!r}")
    return float(value)


def _servo_ids(name: str, value: object, bus: ServoBus) -> set[int]:
    known = [servo.servo_id for servo in bus.servos]
    if not isinstance(value, list) or any(servo_id not in known for servo_id in value):
        raise ValueError(f"{name} takes a list of servo ids out of {known}, not {value!r}")
    return set(value)


def _power_cycle(bus: ServoBus, ids: set[int]) -> None:
    for servo in bus.servos:
        if servo.servo_id in ids:
            servo.power_up()
