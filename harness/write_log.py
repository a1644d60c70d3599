"""Log of every write of the emulator: the servos' registers over time."""

import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Entry:
    """One write or live command, and the state of all servos after it.

    Attributes:
        at_s: monotonic [s].
        command: the live command, None for a write.
        written: names of the registers written, by servo id.
        present: true position by servo id [ticks].
        torque: register TORQUE_ENABLE by servo id.
        goal: register GOAL_POSITION by servo id [ticks].
        status: error bits by servo id.
    """

    at_s: float
    command: dict[str, Any] | None
    written: dict[int, frozenset[str]]
    present: dict[int, int]
    torque: dict[int, int]
    goal: dict[int, int]
    status: dict[int, int]


def read_entries(path: Path) -> list[Entry]:
    """Return every write, oldest first."""
    with path.open() as lines:
        return [_entry(json.loads(line)) for line in lines if line.endswith("\n")]


def pairs(entries: list[Entry]) -> Iterator[tuple[Entry, Entry]]:
    """Return each entry with the one before it."""
    yield from itertools.pairwise(entries)


def _entry(line: dict[str, Any]) -> Entry:
    return Entry(
        at_s=line["t"],
        command=line.get("command"),
        written={int(servo): frozenset(registers) for servo, registers in line.get("registers", {}).items()},
        present=_by_servo(line["present"]),
        torque=_by_servo(line["torque"]),
        goal=_by_servo(line["goal"]),
        status=_by_servo(line["status"]),
    )


def _by_servo(values: dict[str, int]) -> dict[int, int]:
    return {int(servo): value for servo, value in values.items()}
