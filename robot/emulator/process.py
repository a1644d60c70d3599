"""Process of the emulator: its options, and the loop that serves bus, adapter and live commands.

Both ``python -m robot.emulator`` and ``armbridge emulate`` run it.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import select
import signal
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import FrameType

from robot.calibration import Calibration
from robot.control.pacing import take_priority
from robot.emulator.adapter import UsbAdapter
from robot.emulator.arm import build_servos, weight_of
from robot.emulator.control import (
    MAX_COMMAND_BYTES,
    MAX_DELAY_S,
    MAX_HEAT_RATE,
    MAX_USB_FRAME_MS,
    MAX_VOLTAGE_V,
    Emulation,
    answer,
)
from robot.emulator.faults import DELAY_S, PROBABILITIES, Faults
from robot.emulator.rehearsal import REHEARSALS, Rehearsal, TimedCommand, read_script
from robot.emulator.servo import SUPPLY_V, Servo
from robot.emulator.servo_bus import ServoBus
from robot.emulator.write_log import WriteLog

# Time step of the arm while the bus is silent.
TICK_S = 0.02

# When the controlling process has ended, its arm process may still be bringing the arm to rest.
LINGER_S = 1.0

READ_BYTES = 4096

# Positions of option --start.
JOINTS = 6

STDIN, STDOUT = 0, 1


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the emulator's options to a parser."""
    for name, meaning in PROBABILITIES.items():
        parser.add_argument(
            _option(name), type=_probability, default=0.0, metavar="P", help=f"{meaning} with this probability"
        )
    add = parser.add_argument
    add("--delay-s", type=_number(MAX_DELAY_S), default=DELAY_S, metavar="T", help="how long --delay takes [s]")
    add("--seed", type=int, default=0, metavar="N", help="seed of these faults (default 0)")
    add("--usb-frame-ms", type=_number(MAX_USB_FRAME_MS), default=0.0, metavar="T", help="hand replies on so often")
    add("--stall-behind-missing", action="store_true", help="end a sync read at the first servo that is missing")
    add("--supply", type=_number(MAX_VOLTAGE_V), default=SUPPLY_V, metavar="V", help="supply [V] (default 5)")
    add("--heat-rate", type=_number(MAX_HEAT_RATE), default=1.0, metavar="X", help="warm and cool X times faster")
    add("--overload-latches", action="store_true", help="let only a power cycle clear an overload")
    add("--powers-up-holding", action="store_true", help="power up with torque on, at the present position")
    add(
        "--start",
        type=_positions,
        default=[0.0] * JOINTS,
        metavar="Q1,..,Q6",
        help="joint positions at power-up in rad, base to gripper; default all 0",
    )
    add("--calibration", type=Path, metavar="FILE", help="lerobot calibration of the arm (default: an ideal arm)")
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
    add("--repeat", action="store_true", help="play the script again and again")


def build_bus(options: argparse.Namespace, resources: ExitStack, now_s: float, *, wire_time: bool = True) -> ServoBus:
    """Build the servo bus of the options.

    Args:
        options: as parsed.
        resources: takes over the files to close.
        now_s: monotonic time at the start [s].
        wire_time: True to emulate the time of bytes on the wire.

    Raises:
        CalibrationError: the calibration cannot be used.
        ValueError: the start pose is invalid.
        OSError: the log cannot be written.
    """
    calibration = _calibration(options)
    servos = build_servos(calibration, options.start)
    for servo in servos:
        _configure(servo, options)
    log = None
    if options.write_log:
        log = WriteLog(options.write_log)
        resources.callback(log.close)
    return ServoBus(servos, _faults(options), now_s, log, weight_of(calibration, servos), wire_time=wire_time)


def build_rehearsal(options: argparse.Namespace, bus: ServoBus) -> Rehearsal:
    """Build the rehearsal of the options; it has no commands without one.

    Args:
        options: as parsed.
        bus: servo bus that its commands may change.

    Raises:
        CalibrationError: the calibration cannot be used.
        ValueError: the script is invalid, or there is none to repeat.
        OSError: the script cannot be read.
    """
    if options.script:
        return Rehearsal(read_script(options.script, bus), repeats=options.repeat)
    if options.rehearse:
        return Rehearsal(REHEARSALS[options.rehearse](_calibration(options)), repeats=options.repeat)
    if options.repeat:
        raise ValueError("--repeat needs a script to repeat: --script or --rehearse")
    return Rehearsal()


def run(options: argparse.Namespace, control_descriptor: int | None = None) -> None:
    """Run an emulator until a signal or its controlling process ends it.

    Args:
        options: as parsed, see :func:`add_options`.
        control_descriptor: socket to a controlling process; None for a person at standard input and output.

    Raises:
        CalibrationError: the calibration cannot be used.
        ValueError: the start pose or the script is invalid.
        OSError: a file cannot be read or written, or no pseudo terminal can be opened.
    """
    _end_on_signals(controlled=control_descriptor is not None)
    with contextlib.ExitStack() as resources:
        bus = build_bus(options, resources, time.monotonic())
        rehearsal = build_rehearsal(options, bus)
        adapter = UsbAdapter(options.link, options.usb_frame_ms / 1000.0)
        resources.callback(adapter.unplug)
        take_priority()  # servos do not wait for a busy computer
        if control_descriptor is None:
            serve(bus, adapter, Control(STDIN, STDOUT, essential=False), rehearsal)
        else:
            serve(bus, adapter, Control(control_descriptor, control_descriptor, essential=True), rehearsal)


def serve(bus: ServoBus, adapter: UsbAdapter, control: Control, rehearsal: Rehearsal) -> None:
    """Serve the bus for ever, or until an essential controller has ended and the bus is silent.

    Args:
        bus: the servo bus.
        adapter: adapter between host and bus.
        control: connection to the controller.
        rehearsal: timed commands, which start with the first byte from a host.
    """
    emulation = Emulation(bus, adapter)
    control.announce(adapter.port)
    last_heard_s = time.monotonic()
    while control.wanted or time.monotonic() - last_heard_s < LINGER_S:
        watched = [*adapter.descriptors, *control.descriptors]
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
        if any(descriptor in ready for descriptor in control.descriptors):
            control.handle(emulation)


class Control:
    """Connection to the emulator's controller: a person at the terminal, or a process.

    Args:
        reader: file descriptor of the commands.
        writer: file descriptor of the answers.
        essential: True for a controlling process, whose end also ends the emulator.
    """

    def __init__(self, reader: int, writer: int, *, essential: bool) -> None:
        self.essential = essential
        self._reader = reader
        self._writer = writer
        self._buffer = b""
        self._gone = False

    @property
    def descriptors(self) -> list[int]:
        """File descriptors to wait on for commands."""
        return [] if self._gone else [self._reader]

    @property
    def wanted(self) -> bool:
        """True until the end of an essential controller."""
        return not (self._gone and self.essential)

    def announce(self, port: str) -> None:
        """Announce the bus's port: to a controlling process in JSON, to a person as plain text."""
        self._say(json.dumps({"port": port}).encode() + b"\n" if self.essential else port.encode() + b"\n")

    def handle(self, emulation: Emulation) -> None:
        """Carry out and answer the commands that have arrived."""
        try:
            data = os.read(self._reader, READ_BYTES)
        except OSError:
            data = b""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        for line in lines:
            if line.strip():
                self._say(answer(line, emulation))
        self._gone = not data or len(self._buffer) > MAX_COMMAND_BYTES

    def _say(self, line: bytes) -> None:
        """Send one line; dropped when the controller has ended."""
        with contextlib.suppress(OSError):
            os.write(self._writer, line)


def _play(due: TimedCommand, emulation: Emulation) -> None:
    """Carry out a command of a script, and print it and its answer to standard error."""
    line = json.dumps(due.command)
    answered = answer(line.encode(), emulation).decode()
    with contextlib.suppress(OSError):
        sys.stderr.write(f"{due.at_s:.1f} s: {line} {answered}")


def _end_on_signals(*, controlled: bool) -> None:
    """Exit cleanly on SIGTERM and Ctrl-C; a controlled emulator leaves all but SIGTERM to its controller."""

    def end(_number: int, _frame: FrameType | None) -> None:
        """Exit."""
        sys.exit(0)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, signal.SIG_IGN if controlled else end)
    if controlled:
        for number in (signal.SIGHUP, signal.SIGUSR1):
            signal.signal(number, signal.SIG_IGN)


def _calibration(options: argparse.Namespace) -> Calibration:
    return Calibration.load(options.calibration) if options.calibration else Calibration.nominal()


def _faults(options: argparse.Namespace) -> Faults:
    chance = random.Random(options.seed)  # noqa: S311 - repeatable faults, no secret
    probabilities = {name: getattr(options, name) for name in PROBABILITIES}
    stall = options.stall_behind_missing
    return Faults(**probabilities, delay_s=options.delay_s, stall_behind_missing=stall, random=chance)


def _configure(servo: Servo, options: argparse.Namespace) -> None:
    """Give a servo the properties of the options, and power it up."""
    servo.voltage_v = options.supply
    servo.motor.rate = options.heat_rate
    servo.protection.latches = options.overload_latches
    servo.powers_up_holding = options.powers_up_holding
    servo.power_up()


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")


def _probability(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not a probability from 0 to 1")
    return value


def _number(highest: float) -> Callable[[str], float]:
    def number(text: str) -> float:
        """Parse a number from 0 to the highest value."""
        value = float(text)
        if not 0.0 <= value <= highest:
            raise argparse.ArgumentTypeError(f"{text} is not a number from 0 to {highest:g}")
        return value

    return number


def _positions(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers") from error
