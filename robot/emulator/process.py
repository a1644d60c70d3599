"""Process of the emulator: its options, its pseudo terminal, the loop that serves bus and commands, and rehearsals.

A rehearsal has live commands at given times, from a script of JSON lines (docs/simulation.md) or ready-made.
"""

import argparse
import contextlib
import json
import os
import random
import select
import signal
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Annotated

from pydantic import Field

from robot.calibration import Calibration, JointCalibration
from robot.control.pacing import take_priority
from robot.description import robot_folder
from robot.description.robot_folder import RobotFolder
from robot.emulator.arm import Adapter, weight_of
from robot.emulator.control import Controller, Emulation, LiveCommand, answer, carry_out, check, json_object
from robot.emulator.feetech import FEETECH, FeetechServo, build_servos
from robot.emulator.plant import HAND_TICKS_S
from robot.emulator.populations import POPULATIONS
from robot.emulator.servo_bus import EmulatedBus, Faults, WriteLog
from robot.errors import DescriptionError

MAX_AT_S = 86_400.0  # a day; a later time is likely a mistaken unit

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
    """Schedule of commands in order."""

    def __init__(self, commands: Sequence[TimedCommand] = ()) -> None:
        self.commands = tuple(commands)
        self._start_s: float | None = None
        self._next = 0

    def start(self, now_s: float) -> None:
        if self._start_s is None:
            self._start_s = now_s

    def commands_due(self, now_s: float) -> list[TimedCommand]:
        """Return the commands due since the last call."""
        due: list[TimedCommand] = []
        if self._start_s is None:
            return due
        while self._next < len(self.commands) and self.commands[self._next].at_s <= now_s - self._start_s:
            due.append(self.commands[self._next])
            self._next += 1
        return due


class ScriptLine(LiveCommand):
    """Line of a script: live commands and their time from the start of the script."""

    at_s: Annotated[float, Field(ge=0.0, le=MAX_AT_S)]


def read_script(path: Path, bus: EmulatedBus[FeetechServo]) -> tuple[TimedCommand, ...]:
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


def _timed_command(line: bytes, previous_s: float, bus: EmulatedBus[FeetechServo]) -> TimedCommand:
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


REHEARSALS: Mapping[str, Callable[[Calibration], tuple[TimedCommand, ...]]] = {
    "sweep": sweep,
    "push": push,
    "stall": stall,
}


def _hand_motion(ticks: Mapping[JointCalibration, int | None]) -> dict[str, object]:
    return {"hand": {str(joint.servo_id): target for joint, target in ticks.items()}}


def _middle_ticks(joint: JointCalibration) -> int:
    return (joint.range_min + joint.range_max) // 2


def _halfway_along(calibration: Calibration) -> JointCalibration:
    return calibration.joints[(len(calibration.joints) - 1) // 2]


READ_BYTES = 4096

_OSPEED = 5  # index of the output speed in the result of tcgetattr

# Baud rates of the servos that termios knows.
_BAUDRATES: Mapping[int, int] = {
    termios.B1000000: 1_000_000,
    termios.B500000: 500_000,
    termios.B115200: 115_200,
    termios.B57600: 57_600,
    termios.B38400: 38_400,
}


class UsbAdapter(Adapter):
    """USB adapter, whose port is a pseudo terminal; a symbolic link stays the same when the port's name changes.

    The slave stays open here, or the master would fail whenever a client leaves, and is raw before any client opens it,
    or the line discipline would echo and alter bytes.
    """

    def __init__(self, link: Path | None = None) -> None:
        super().__init__("")
        self._link = link
        self._terminal: tuple[int, int] | None = None  # master and slave; None while it is unplugged
        self.plug_in()

    @property
    def descriptors(self) -> list[int]:
        return [] if self.frozen or self._terminal is None else [self._terminal[0]]

    @property
    def baudrate(self) -> int:
        """Baud rate that the host has set; 0 for a rate without servos, or while unplugged."""
        return 0 if self._terminal is None else _BAUDRATES.get(termios.tcgetattr(self._terminal[1])[_OSPEED], 0)

    def plug_in(self, *, renamed: bool = False) -> None:
        if self._terminal is not None:
            return
        master, slave = os.openpty()
        if renamed and os.ttyname(slave) == self.port:
            former, (master, slave) = (master, slave), os.openpty()
            _close(former)
        tty.setraw(slave)
        os.set_blocking(master, False)
        if self._link is not None:
            if self._link.is_symlink():
                self._link.unlink()
            self._link.symlink_to(os.ttyname(slave))
        self._terminal, self.port = (master, slave), os.ttyname(slave)

    def unplug(self) -> None:
        """Remove the port and its link, and drop the bytes not delivered yet."""
        if self._terminal is not None:
            _close(self._terminal)
            if self._link is not None:
                self._link.unlink(missing_ok=True)
        self._terminal = None
        self._outbox.clear()

    def read(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            return b"" if self._terminal is None else os.read(self._terminal[0], READ_BYTES)
        return b""

    def deliver(self, now_s: float) -> None:
        """Send the host the bytes that are due; without a port, or room in its buffer, they are lost, as on a wire."""
        due = self.due_bytes(now_s)
        if due and self._terminal is not None:
            with contextlib.suppress(BlockingIOError):
                os.write(self._terminal[0], due)


def _close(descriptors: Iterable[int]) -> None:
    for descriptor in descriptors:
        os.close(descriptor)


TICK_S = 0.02  # time step of the arm while the bus is silent
LINGER_S = 1.0  # when the controlling process has ended, its arm process may still be bringing the arm to rest


STDIN, STDOUT = 0, 1

# Live commands that are options as well: those with a number.
_NUMBERS = (
    *("drop", "corrupt", "wrong_id", "truncate", "duplicate", "noise", "delay", "delay_s", "lose_instruction"),
    *("supply", "heat_rate", "usb_frame_ms"),
)


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    for name in _NUMBERS:
        meaning = LiveCommand.model_fields[name].description
        add("--" + name.replace("_", "-"), type=_number(name), metavar="X", help=meaning)
    add("--seed", type=int, default=0, metavar="N", help="seed of the random faults (default 0)")
    add(
        "--population",
        choices=POPULATIONS,
        default="factory",
        help="state of the servos: as new ones of an arm that was calibrated (factory), as lerobot or a ROS 2 driver "
        "leaves them, compatible ones of 12 V (clone), or new servos, all with id 1 (kit)",
    )
    add(
        "--start",
        type=_positions,
        default=[],
        metavar="Q1,..,QN",
        help="joint positions at power-up in rad, base to gripper; default all 0",
    )
    add(
        "--robot",
        type=_robot,
        default="so101",
        metavar="NAME_OR_FOLDER",
        help="arm with Feetech servos: a built-in one, or the folder of its robot.toml (so101)",
    )
    add("--calibration", type=Path, metavar="FILE", help="lerobot calibration of the arm (default: a flawless arm)")
    add("--write-log", type=Path, metavar="FILE", help="record every write here, one JSON line each")
    add("--link", type=Path, metavar="PATH", help="make a symbolic link to the terminal here")
    script = parser.add_mutually_exclusive_group()
    script.add_argument(
        "--script",
        type=Path,
        metavar="FILE",
        help='play these live commands from the host\'s first byte on: JSON lines with a time, {"at_s": 1.5, ...}',
    )
    script.add_argument(
        "--rehearse",
        choices=REHEARSALS,
        help="play a ready-made script: sweep, a hand moves every joint from stop to stop; push, something pushes a "
        "joint and lets go; stall, an obstacle is in a joint's way, and later goes",
    )
    # Inherited socket of a controlling process: its end ends the emulator.
    add("--control-fd", type=int, help=argparse.SUPPRESS)


def build_bus(
    options: argparse.Namespace, resources: ExitStack, now_s: float, *, wire_time: bool = True
) -> EmulatedBus[FeetechServo]:
    """Build the servo bus of the options at a monotonic time [s]; the resources take over the files to close."""
    calibration = _calibration(options)
    start_rad = options.start or [0.0] * len(calibration.joints)
    servos = build_servos(calibration, start_rad, POPULATIONS[options.population])
    log = None
    if options.write_log:
        log = WriteLog(options.write_log)
        resources.callback(log.close)
    return EmulatedBus(
        servos,
        FEETECH,
        Faults(random=random.Random(options.seed)),  # noqa: S311 - repeatable faults, no secret
        now_s,
        log,
        weight_of(options.robot.model, calibration, servos),
        wire_time=wire_time,
    )


def configure(options: argparse.Namespace, emulation: Emulation) -> None:
    values: dict[str, object] = {name: value for name in _NUMBERS if (value := getattr(options, name)) is not None}
    carry_out(check(LiveCommand, values, emulation.bus.servos), values, emulation)


def build_rehearsal(options: argparse.Namespace, bus: EmulatedBus[FeetechServo]) -> Rehearsal:
    """Build the rehearsal of the options, without commands if they name none; raises as :func:`run` does."""
    if options.script:
        return Rehearsal(read_script(options.script, bus))
    if options.rehearse:
        return Rehearsal(REHEARSALS[options.rehearse](_calibration(options)))
    return Rehearsal()


def run(options: argparse.Namespace) -> None:
    """Run an emulator until a signal or its controlling process ends it.

    Raises CalibrationError, ValueError for a start pose or script that cannot be, and OSError for files and terminals.
    """
    controlled = options.control_fd is not None
    _end_on_signals(controlled=controlled)
    with contextlib.ExitStack() as resources:
        bus = build_bus(options, resources, time.monotonic())
        rehearsal = build_rehearsal(options, bus)
        adapter = UsbAdapter(options.link)
        resources.callback(adapter.unplug)
        configure(options, Emulation(bus, adapter))
        take_priority()  # servos do not wait for a busy computer
        ends = (options.control_fd,) * 2 if controlled else (STDIN, STDOUT)
        controller = Controller(*ends)
        controller.write((json.dumps({"port": adapter.port}) if controlled else adapter.port).encode() + b"\n")
        serve(bus, adapter, controller, rehearsal, essential=controlled)


def serve(
    bus: EmulatedBus[FeetechServo],
    adapter: UsbAdapter,
    controller: Controller,
    rehearsal: Rehearsal,
    *,
    essential: bool,
) -> None:
    """Serve the bus until an essential controller has ended; the rehearsal starts with the first byte from a host."""
    emulation = Emulation(bus, adapter)
    last_heard_s = time.monotonic()
    while not (essential and controller.gone) or time.monotonic() - last_heard_s < LINGER_S:
        watched = adapter.descriptors if controller.gone else [*adapter.descriptors, controller.reader]
        ready, _, _ = select.select(watched, [], [], adapter.wait_s(time.monotonic(), TICK_S))
        now_s = time.monotonic()
        if ready:
            last_heard_s = now_s
        if any(descriptor in ready for descriptor in adapter.descriptors):
            data = adapter.read()
            if data:
                rehearsal.start(now_s)
            adapter.take(bus.receive(data, now_s, adapter.baudrate))
        bus.advance(now_s)
        adapter.deliver(now_s)
        for due in rehearsal.commands_due(now_s):
            _play(due, emulation)
        if not controller.gone and controller.reader in ready:
            controller.handle(emulation)


def _play(due: TimedCommand, emulation: Emulation) -> None:
    line = json.dumps(due.command)
    answered = answer(line.encode(), emulation).decode()
    with contextlib.suppress(OSError):
        sys.stderr.write(f"{due.at_s:.1f} s: {line} {answered}")


def _end_on_signals(*, controlled: bool) -> None:
    """Exit cleanly on SIGTERM and Ctrl-C; a controlled emulator leaves all but SIGTERM to its controller."""

    def end(_number: int, _frame: FrameType | None) -> None:
        sys.exit(0)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, signal.SIG_IGN if controlled else end)
    if controlled:
        for number in (signal.SIGHUP, signal.SIGUSR1):
            signal.signal(number, signal.SIG_IGN)


def _calibration(options: argparse.Namespace) -> Calibration:
    servos = options.robot.hardware.servos
    return Calibration.load(options.calibration, servos) if options.calibration else Calibration.nominal(servos)


def _number(name: str) -> Callable[[str], float]:
    def number(text: str) -> float:
        value = float(text)
        try:
            check(LiveCommand, {name: value}, ())
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error
        return value

    return number


def _robot(name_or_folder: str) -> RobotFolder:
    try:
        found = robot_folder.resolve(name_or_folder)
    except DescriptionError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    if found.hardware.kind != "feetech":
        raise argparse.ArgumentTypeError(
            f"{found.title} has no Feetech servos, but hardware.kind {found.hardware.kind}"
        )
    return found


def _positions(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers") from error
