"""The emulator's process: the adapter, the servos behind it, and a line of control."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import signal
import sys
import time
from types import FrameType

from robot.control.pacing import take_priority
from robot.emulator.adapter import UsbAdapter
from robot.emulator.commands import Emulation
from robot.emulator.control import answer
from robot.emulator.options import build_bus, build_rehearsal
from robot.emulator.rehearsal import Rehearsal, TimedCommand
from robot.emulator.servo_bus import ServoBus

# How often the arm moves on while the bus is silent.
TICK_S = 0.02

# After the controlling process went away its arm process may still be bringing the arm to rest.
LINGER_S = 1.0

READ_BYTES = 4096

# A command is short; who sends more without a line end is no controller.
MAX_COMMAND_BYTES = 64 << 10


STDIN, STDOUT = 0, 1


class Control:
    """The line to whoever controls the emulator.

    Args:
        reader: descriptor on which commands come.
        writer: descriptor on which they are answered.
        essential: whether the emulator ends when the controller is gone.
    """

    def __init__(self, reader: int, writer: int, *, essential: bool) -> None:
        self.essential = essential
        self._reader = reader
        self._writer = writer
        self._buffer = b""
        self._gone = False

    @property
    def descriptors(self) -> list[int]:
        """What to wait for until a command comes."""
        return [] if self._gone else [self._reader]

    @property
    def wanted(self) -> bool:
        """Whether somebody may still want the emulator to run."""
        return not (self._gone and self.essential)

    def announce(self, port: str) -> None:
        """Tell where the bus is: a controlling process in JSON, a person in plain words."""
        self._say(json.dumps({"port": port}).encode() + b"\n" if self.essential else port.encode() + b"\n")

    def obey(self, emulation: Emulation) -> None:
        """Carry out and answer the commands that have come."""
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
        """Send one line; a controller that is gone does not matter here."""
        with contextlib.suppress(OSError):
            os.write(self._writer, line)


def run(options: argparse.Namespace, control_descriptor: int | None = None) -> None:
    """Run an emulator until it is told to end.

    Args:
        options: of ``robot.emulator.options``.
        control_descriptor: a socket to a controlling process; None for a person at standard input and output.

    Raises:
        CalibrationError: the calibration cannot be used.
        ValueError: the start pose or the script is not one.
        OSError: a file cannot be read or written, or there is no terminal to be had.
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
    """Run the bus for ever, or until an essential controller is gone and the bus is silent.

    The rehearsal starts with the first byte from a host.
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
            control.obey(emulation)


def _play(due: TimedCommand, emulation: Emulation) -> None:
    """Carry out a command of a script, and tell it and its answer on standard error."""
    line = json.dumps(due.command)
    answered = answer(line.encode(), emulation).decode()
    with contextlib.suppress(OSError):
        sys.stderr.write(f"{due.at_s:.1f} s: {line} {answered}")


def _end_on_signals(*, controlled: bool) -> None:
    """End in good order on SIGTERM and Ctrl-C; a controlled emulator leaves all but the former to its controller."""

    def end(_number: int, _frame: FrameType | None) -> None:
        sys.exit(0)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, signal.SIG_IGN if controlled else end)
    if controlled:
        for number in (signal.SIGHUP, signal.SIGUSR1):
            signal.signal(number, signal.SIG_IGN)
