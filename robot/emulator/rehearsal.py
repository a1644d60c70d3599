"""Rehearsals: live commands at given times, from a script of JSON lines (docs/rehearsal.md) or ready-made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

from pydantic import Field

from robot.calibration import Calibration, JointCalibration
from robot.emulator.control import LiveCommand, check, json_object
from robot.emulator.feetech import FeetechServo
from robot.emulator.plant import HAND_TICKS_S
from robot.emulator.servo_bus import ServoBus

MAX_AT_S = 86_400.0  # a day; a later time is likely a mistaken unit
MIN_REPEATED_S = 0.1  # shortest duration of a repeated script [s]: a shorter one would keep the loop that plays it busy

# Time from the host's first byte to the first event of a ready-made rehearsal: a person reads the question of
# `armbridge calibrate` and presses Enter, a server takes the arm over.
LEAD_S = 10.0

REST_S = 1.0  # a hand rests at each end, so that readings every 20 ms see the joint there even when the machine is busy

# Most of the load that the default torque limit (800) can hold; the position loop gives way by 30 ticks.
PUSH_PERMILLE = 500
PUSH_S = 5.0

# The obstacle stands by this share of the joint's range above its middle: 0.17 rad at the SO-101's elbow, which the
# named target `ready` moves by 0.5 rad.
OBSTACLE_SHARE = 0.05

OBSTACLE_S = 30.0  # time to send a goal and see it fail


@dataclass(frozen=True)
class TimedCommand:
    """Live command with a time."""

    at_s: float  # time from the start of the script [s]
    command: Mapping[str, object]  # command for :func:`robot.emulator.control.answer`


class Rehearsal:
    """Schedule of commands in order; raises ValueError for a repeated one shorter than :data:`MIN_REPEATED_S`."""

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
        """Return the commands due since the last call; the next round starts when the last command is noticed."""
        due: list[TimedCommand] = []
        if self._start_s is None:
            return due
        while self._next < len(self.commands) and self.commands[self._next].at_s <= now_s - self._start_s:
            due.append(self.commands[self._next])
            self._next += 1
        if self._repeats and self._next == len(self.commands):
            self._start_s, self._next = now_s, 0
        return due


class ScriptLine(LiveCommand):
    """Line of a script: live commands and their time from the start of the script."""

    at_s: Annotated[float, Field(ge=0.0, le=MAX_AT_S)]


def read_script(path: Path, bus: ServoBus[FeetechServo]) -> tuple[TimedCommand, ...]:
    """Read a script and check its commands; raises OSError, and ValueError that names file and line."""
    commands: list[TimedCommand] = []
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        if not line.strip():
            continue
        try:
            commands.append(_timed_command(line, commands[-1].at_s if commands else -1.0, bus))
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from error
    if not commands:
        raise ValueError(f"{path}: the script has no commands")
    return tuple(commands)


def _timed_command(line: bytes, previous_s: float, bus: ServoBus[FeetechServo]) -> TimedCommand:
    values = json_object(line)
    at_s = check(ScriptLine, values, bus.servos).at_s
    if at_s <= previous_s:
        raise ValueError(f"at_s: must be more than the {previous_s:g} of the line before, not {at_s:g}")
    del values["at_s"]
    return TimedCommand(at_s, values)


def sweep(calibration: Calibration) -> tuple[TimedCommand, ...]:
    """Move the arm by hand to its middle, then every joint with stops from stop to stop, as for ``calibrate``."""
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
