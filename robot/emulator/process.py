"""The emulator's process: a pseudo terminal, the servos behind it, and a line of control."""

from __future__ import annotations

import contextlib
import json
import os
import select
import time
import tty
from collections import deque
from pathlib import Path

from robot.emulator.control import answer
from robot.emulator.wire import Reply, ServoBus

# How often the arm moves on while the bus is silent.
TICK_S = 0.02

# After the controlling process went away its arm process may still be bringing the arm to rest.
LINGER_S = 1.0

READ_BYTES = 4096

# A command is short; who sends more without a line end is no controller.
MAX_COMMAND_BYTES = 64 << 10


class PseudoTerminal:
    """A serial port made of software.

    The slave stays open here, or the master would fail whenever a client leaves, and is raw before any client
    opens it, or the line discipline would echo and alter bytes.

    Args:
        link: where to put a symbolic link to the slave, if anywhere.
    """

    def __init__(self, link: Path | None = None) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self.port = os.ttyname(self._slave)
        self._link = link
        if link is not None:
            if link.is_symlink():
                link.unlink()
            link.symlink_to(self.port)

    def read(self) -> bytes:
        """Return what the client has written."""
        try:
            return os.read(self.master, READ_BYTES)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Give bytes to the client; those that nobody fetches are lost, as on a wire."""
        with contextlib.suppress(BlockingIOError):
            os.write(self.master, data)

    def close(self) -> None:
        """Take the port away."""
        os.close(self.master)
        os.close(self._slave)
        if self._link is not None:
            self._link.unlink(missing_ok=True)


class Control:
    """The line to the process that started the emulator.

    Args:
        descriptor: an inherited socket.
    """

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._buffer = b""

    def say(self, line: bytes) -> None:
        """Send one line; a controller that is gone does not matter here."""
        with contextlib.suppress(OSError):
            os.write(self.descriptor, line)

    def obey(self, bus: ServoBus) -> bool:
        """Carry out and answer the commands that have come.

        Returns:
            False once the controller is gone.
        """
        try:
            data = os.read(self.descriptor, READ_BYTES)
        except OSError:
            data = b""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        for line in lines:
            self.say(answer(line, bus))
        return bool(data) and len(self._buffer) <= MAX_COMMAND_BYTES


def serve(terminal: PseudoTerminal, bus: ServoBus, control: Control | None) -> None:
    """Run the bus until the controller is gone and the bus is silent; for ever without a controller."""
    announcement = json.dumps({"port": terminal.port}).encode() + b"\n"
    if control is not None:
        control.say(announcement)
    outbox: deque[Reply] = deque()
    controlled, last_heard_s = control is not None, time.monotonic()
    while control is None or controlled or time.monotonic() - last_heard_s < LINGER_S:
        watched = [terminal.master]
        if control is not None and controlled:
            watched.append(control.descriptor)
        ready, _, _ = select.select(watched, [], [], _wait_s(outbox, time.monotonic()))
        now_s = time.monotonic()
        if terminal.master in ready:
            outbox.extend(bus.receive(terminal.read(), now_s))
            last_heard_s = now_s
        bus.advance(now_s)
        _deliver(outbox, terminal, now_s)
        if control is not None and control.descriptor in ready:
            controlled = control.obey(bus)
            last_heard_s = now_s


def _wait_s(outbox: deque[Reply], now_s: float) -> float:
    return max(0.0, min(TICK_S, outbox[0].due_s - now_s)) if outbox else TICK_S


def _deliver(outbox: deque[Reply], terminal: PseudoTerminal, now_s: float) -> None:
    while outbox and outbox[0].due_s <= now_s:
        terminal.write(outbox.popleft().data)
