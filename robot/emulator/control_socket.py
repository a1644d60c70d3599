"""Live commands to the emulated servos inside the arm process, on a Unix socket."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Sequence
from pathlib import Path

from robot.emulator.adapter import InProcessPort
from robot.emulator.control import CommandStream, Emulation
from robot.emulator.feetech import FeetechServo
from robot.emulator.servo_bus import ServoBus

# One is in use at a time; the rest allows for connections that were not closed.
MAX_CONTROLLERS = 8

READ_BYTES = 4096


class CommandedPort(InProcessPort):
    """Port that polls a socket for live commands, once at each time of the clock."""

    def __init__(self, bus: ServoBus[FeetechServo], clock: Callable[[], float], control: ControlSocket) -> None:
        super().__init__(bus, clock)
        self._emulation = Emulation(bus, self)
        self._control = control
        self._polled_s = clock()

    def check(self) -> None:
        """Carry out the commands that have arrived; raise PortError while the port is unplugged."""
        self._poll()
        super().check()

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        """Carry out the commands that have arrived, then pass a packet to the servos."""
        if self._clock() != self._polled_s:
            self._poll()
        return super().writePort(packet)

    def _poll(self) -> None:
        """Bring the servos up to the present, then carry out the commands, which the log records with this time."""
        self._polled_s = self._clock()
        self._bus.advance(self._polled_s)
        self._control.poll(self._emulation)


class ControlSocket:
    """Unix socket for live commands, one JSON object a line (:mod:`robot.emulator.control`).

    A socket that an ended process has left is replaced. Raises OSError where something else is in its place.
    """

    def __init__(self, path: Path) -> None:
        with contextlib.suppress(FileNotFoundError):
            if path.is_socket():
                path.unlink()
        self._listener = socket.socket(socket.AF_UNIX)
        try:
            self._listener.bind(str(path))
        except OSError:
            self._listener.close()
            raise
        self._listener.listen()
        self._listener.setblocking(False)
        self._streams: dict[socket.socket, CommandStream] = {}

    def poll(self, emulation: Emulation) -> None:
        """Carry out and answer the commands that have arrived; never waits."""
        with contextlib.suppress(OSError):
            controller, _ = self._listener.accept()
            if len(self._streams) < MAX_CONTROLLERS:
                controller.setblocking(False)
                self._streams[controller] = CommandStream()
            else:
                controller.close()
        for controller, stream in list(self._streams.items()):
            data = _received(controller)
            if data is None:
                continue
            with contextlib.suppress(OSError):
                controller.sendall(b"".join(stream.feed(data, emulation)))
            if not data or stream.overlong:
                del self._streams[controller]
                controller.close()


def _received(controller: socket.socket) -> bytes | None:
    """Return the bytes that have arrived, None for none; no bytes at the end of the connection."""
    try:
        return controller.recv(READ_BYTES)
    except BlockingIOError:
        return None
    except OSError:
        return b""
