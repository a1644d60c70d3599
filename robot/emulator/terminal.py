"""A serial port made of software: a pseudo terminal."""

from __future__ import annotations

import contextlib
import os
import termios
import tty
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

READ_BYTES = 4096

# Where tcgetattr has the output speed.
_OSPEED = 5

# Line speeds that termios knows, of those that a servo can have.
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
    """A pair of master and slave.

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

    @property
    def baudrate(self) -> int:
        """Speed that the client has set; 0 for one that no servo has."""
        return _BAUDRATES.get(termios.tcgetattr(self._slave)[_OSPEED], 0)

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

    def leave_link(self) -> None:
        """Leave the link to another terminal that has put its own in the same place."""
        self._link = None

    def close(self) -> None:
        """Take the port away."""
        os.close(self.master)
        os.close(self._slave)
        if self._link is not None:
            self._link.unlink(missing_ok=True)
