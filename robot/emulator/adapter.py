"""USB adapter between host and servo bus, on a pseudo terminal: it can be unplugged, freeze, and deliver in frames."""

from __future__ import annotations

import contextlib
import math
import os
import termios
import tty
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from robot.emulator.servo_bus import Reply

READ_BYTES = 4096

# Index of the output speed in the result of tcgetattr.
_OSPEED = 5

# Baud rates of the servos that termios knows.
_BAUDRATES: Mapping[int, int] = MappingProxyType(
    {
        termios.B1000000: 1_000_000,
        termios.B500000: 500_000,
        termios.B115200: 115_200,
        termios.B57600: 57_600,
        termios.B38400: 38_400,
    }
)


class PseudoTerminal:
    """Pseudo terminal: a pair of master and slave.

    The slave stays open here, or the master would fail whenever a client leaves, and is raw before any client
    opens it, or the line discipline would echo and alter bytes.

    Args:
        link: path of a symbolic link to the slave; None for no link.

    Attributes:
        master: file descriptor of the emulator's end.
        port: path of the slave, which clients open.
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

    @property
    def baudrate(self) -> int:
        """Baud rate that the client has set; 0 for one that no servo has."""
        return _BAUDRATES.get(termios.tcgetattr(self._slave)[_OSPEED], 0)

    def read(self) -> bytes:
        """Return what the client has written."""
        try:
            return os.read(self.master, READ_BYTES)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send bytes to the client; those that do not fit into its buffer are lost, as on a wire."""
        with contextlib.suppress(BlockingIOError):
            os.write(self.master, data)

    def leave_link(self) -> None:
        """Keep the link on :meth:`close`: another terminal has replaced it with its own."""
        self._link = None

    def close(self) -> None:
        """Take the port away."""
        os.close(self.master)
        os.close(self._slave)
        if self._link is not None:
            self._link.unlink(missing_ok=True)


class UsbAdapter:
    """USB adapter, whose serial port comes and goes.

    Args:
        link: path of a symbolic link to the port, which stays the same when the port's own name changes; None for no
            link.
        frame_s: initial value of the attribute.

    Attributes:
        port: name of the port, the last one while it is unplugged.
        frozen: True while it neither takes nor delivers bytes, which wait meanwhile.
        frame_s: interval at multiples of which the servos' bytes are delivered [s]; 0 delivers them at once.
    """

    def __init__(self, link: Path | None = None, frame_s: float = 0.0) -> None:
        self.frozen = False
        self.frame_s = frame_s
        self._link = link
        self._outbox: deque[tuple[float, Reply]] = deque()
        self._terminal: PseudoTerminal | None = None
        self.port = ""
        self.plug_in()

    @property
    def descriptors(self) -> list[int]:
        """File descriptors to wait on for bytes from the host."""
        return [] if self.frozen or self._terminal is None else [self._terminal.master]

    @property
    def baudrate(self) -> int:
        """Baud rate that the host has set; 0 for one that no servo has, or while unplugged."""
        return 0 if self._terminal is None else self._terminal.baudrate

    def plug_in(self, *, renamed: bool = False) -> None:
        """Create the port, unless it is there.

        Args:
            renamed: True for a name that differs from the last one.
        """
        if self._terminal is not None:
            return
        terminal = PseudoTerminal(self._link)
        if renamed and terminal.port == self.port:
            replaced, terminal = terminal, PseudoTerminal(self._link)
            replaced.leave_link()
            replaced.close()
        self._terminal, self.port = terminal, terminal.port

    def unplug(self) -> None:
        """Remove the port and its link, and drop the bytes not delivered yet."""
        if self._terminal is not None:
            self._terminal.close()
        self._terminal = None
        self._outbox.clear()

    def read(self) -> bytes:
        """Return what the host has written."""
        return b"" if self._terminal is None else self._terminal.read()

    def take(self, replies: Sequence[Reply]) -> None:
        """Queue replies of the servos, to be delivered to the host when they are due.

        Without frames a burst is delivered as a whole, which wakes the host once.
        """
        if self._terminal is None or not replies:
            return
        for reply in replies:
            due_s = math.ceil(reply.due_s / self.frame_s) * self.frame_s if self.frame_s else replies[-1].due_s
            self._outbox.append((due_s, reply))

    def wait_s(self, now_s: float, most_s: float) -> float:
        """Return the time until bytes are due for the host [s], ``most_s`` at most."""
        if not self._outbox or self.frozen:
            return most_s
        return max(0.0, min(most_s, self._outbox[0][0] - now_s))

    def deliver(self, now_s: float) -> None:
        """Send the host the bytes that are due."""
        if self.frozen or self._terminal is None:
            return
        due = b""
        while self._outbox and self._outbox[0][0] <= now_s:
            due += self._outbox.popleft()[1].data
        if due:
            self._terminal.write(due)
