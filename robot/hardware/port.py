"""Serial port of the servo bus; every operation ends in bounded time.

``scservo_sdk`` writes its packets through a ``PortHandler``. Its own never discards stale input, may share the device
with another process, has no write timeout and stays locked after an exception; :class:`SerialPort` does better. Replies
are read without the SDK, by :meth:`SerialPort.receive`.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import grp
import io
import os
import select
import termios
from collections.abc import Sequence
from typing import Protocol

import serial
from scservo_sdk import PortHandler

from robot.errors import PortBusy, PortError, PortLost

BITS_PER_BYTE = 10  # start bit, eight data bits and stop bit

# A sync write of 56 bytes takes 0.6 ms; an adapter that has not taken it in 100 ms is gone or stuck.
WRITE_TIMEOUT_S = 0.1

READ_BYTES = 4096  # more than any burst of replies: six telemetry blocks have 126 bytes
MAX_CLEARING_READS = 16  # bound on clearing the input of a device that sends faster than it is read

# Latency of replies through the host's own serial port (USB frames, scheduling) and through a network. Behind a pseudo
# terminal is a program, which replies when it gets its turn: on two cores, half of them taken by a virtual machine's
# host, one reply in a hundred came 0.2 s late.
LOCAL_LATENCY_S = 0.005
NETWORK_LATENCY_S = 0.05
TERMINAL_LATENCY_S = 0.3

# A burst of replies that stops for this long has ended: three USB frames of 1 ms, and more for a pseudo terminal, whose
# program may lose its turn between two replies.
QUIET_S = 0.003
TERMINAL_QUIET_S = 0.1

# Pseudo terminals are not claimed: their other end would keep the claim of a process that has died.
PSEUDO_TERMINALS = "/dev/pts/"

DEVICE_ERRORS = (OSError, termios.error)  # errors of an unplugged adapter; ``termios.error`` is not an OSError

_NOT_FOUND = frozenset({errno.ENOENT, errno.ENXIO, errno.ENODEV})
_PERMISSION = frozenset({errno.EACCES, errno.EPERM})
_BUSY = frozenset({errno.EBUSY, errno.EAGAIN})


class BusPort(Protocol):
    """Port of a servo bus, as the bus and the makers' SDKs use it; every method may raise PortLost."""

    port_name: str  # name in errors
    baudrate: int  # bits per second
    is_using: bool  # the SDK's lock
    latency_s: float  # time that a reply may take beyond its wire time [s]
    quiet_s: float  # pause after which a burst of replies counts as ended [s]
    discarded_bytes: int  # unexpected input bytes discarded so far

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name
        """Discard the input that has arrived."""

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        """Write a packet; return the number of bytes written."""

    def receive(self, timeout_s: float, /) -> bytes:
        """Return bytes as soon as some have arrived; none after ``timeout_s`` [s]."""

    def closePort(self) -> None:  # noqa: N802 - the SDK's name
        """Close the port, even if it is gone."""


def wire_time_s(byte_count: int, baudrate: int) -> float:
    return byte_count * BITS_PER_BYTE / baudrate


def open_port(port: str, baudrate: int) -> SerialPort:
    """Open a serial port for this process alone: a device path, or a pyserial URL such as ``socket://host:port``.

    Raises PortError, which is PortBusy for a port in use, and ValueError for a baud rate that no servo has.
    """
    handler = SerialPort(port)
    if not handler.setBaudRate(baudrate):
        raise ValueError(f"{baudrate} baud is not a rate of the servos")
    return handler


class SerialPort(PortHandler):
    """Serial port to which ``scservo_sdk`` writes, and from which the bus reads."""

    def __init__(self, port_name: str) -> None:
        super().__init__(port_name)
        self.latency_s = NETWORK_LATENCY_S if "://" in port_name else LOCAL_LATENCY_S
        self.quiet_s = QUIET_S
        self.discarded_bytes = 0
        self._poll = select.poll()

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802 - the SDK's hook for opening the device
        """Open the device; the SDK calls this once it knows the baud rate."""
        self.closePort()
        self.ser = line = _open_line(self.port_name, cflag_baud)
        self.is_open = True
        self.is_using = False
        # The kernel is not to collect input for 16 ms, as FTDI's driver does; other drivers reject this, and need not.
        with contextlib.suppress(ValueError, NotImplementedError, AttributeError):
            line.set_low_latency_mode(True)
        try:
            descriptor = line.fileno()
        except io.UnsupportedOperation as error:
            self.closePort()
            raise PortError(self.port_name, "has no file descriptor: of URLs, give socket://host:port") from error
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)
        if os.path.realpath(self.port_name).startswith(PSEUDO_TERMINALS):
            self.latency_s, self.quiet_s = TERMINAL_LATENCY_S, TERMINAL_QUIET_S
        else:
            _claim(descriptor)
        return True

    def closePort(self) -> None:  # noqa: N802 - the SDK's name
        self.is_open = False
        if self.ser is not None:
            with contextlib.suppress(OSError, termios.error):
                self.ser.close()
            self.ser = None

    def clearPort(self) -> None:  # noqa: N802 - the SDK calls this before it writes
        for _ in range(MAX_CLEARING_READS):
            stale = self.receive(0.0)
            if not stale:
                break
            self.discarded_bytes += len(stale)

    def writePort(self, packet: Sequence[int]) -> int:  # noqa: N802 - the SDK calls this to write
        data, line = bytes(packet), self._open_line()
        try:
            written = _write_at_once(line.fileno(), data)
            if written < len(data):
                # pyserial waits until the device takes more, for WRITE_TIMEOUT_S at most.
                written += line.write(data[written:]) or 0
        except DEVICE_ERRORS as error:
            raise PortLost(self.port_name, str(error)) from error
        return written

    def receive(self, timeout_s: float) -> bytes:
        line = self._open_line()
        try:
            if not self._poll.poll(timeout_s * 1000.0):
                return b""
            data = os.read(line.fileno(), READ_BYTES)
        except BlockingIOError:
            return b""
        except DEVICE_ERRORS as error:
            raise PortLost(self.port_name, str(error)) from error
        if not data:
            raise PortLost(self.port_name, "the other end closed it")
        return data

    def _open_line(self) -> serial.Serial:
        if self.ser is None:
            raise PortLost(self.port_name, "it is not open")
        return self.ser


def _write_at_once(descriptor: int, data: bytes) -> int:
    try:
        return os.write(descriptor, data)
    except BlockingIOError:
        return 0


def _open_line(port: str, baudrate: int) -> serial.Serial:
    try:
        return serial.serial_for_url(port, baudrate=baudrate, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError, termios.error) as error:
        raise _refusal(port, getattr(error, "errno", None), str(error)) from error


def _refusal(port: str, code: int | None, reason: str) -> PortError:
    if code in _NOT_FOUND:
        return PortError(port, "does not exist: is the adapter plugged in? /dev/serial/by-id/ lists those that are")
    if code in _PERMISSION:
        group = _owning_group(port)
        join = f"join the group {group} (`sudo usermod -aG {group} $USER`, then log in again)"
        if group.isdigit():
            # A group without a name here, as in a container.
            join = f"give the container its group, --group-add {group}"
        return PortError(port, f"may not be opened by this user: {join}, or add a udev rule (docs/hardware.md)")
    if code in _BUSY:
        return PortBusy(port)
    return PortError(port, f"cannot be opened: {reason}")


def _owning_group(port: str) -> str:
    """Return the group that may open a device, or its number; Debian's group for a device of root alone."""
    try:
        number = os.stat(port).st_gid  # noqa: PTH116 - a port may be a URL
    except OSError:
        number = 0
    if number == 0:
        return "dialout"
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def _claim(descriptor: int) -> None:
    """Keep out programs that ignore pyserial's lock, until the device is closed; only terminals support this."""
    with contextlib.suppress(OSError):
        fcntl.ioctl(descriptor, termios.TIOCEXCL)
