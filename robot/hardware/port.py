"""Serial port of the servo bus, by name, USB id or ``auto``; every operation ends in bounded time.

A USB id names the board's serial chip, not the board: chips of the boards that servo arms are sold with come first;
chips that a few servo boards share with other devices are taken only where no board of the first class is plugged in.

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
import re
import select
import termios
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import serial
from scservo_sdk import PortHandler
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from robot.errors import PortBusy, PortError, PortLost

# Device names that do not depend on the order in which boards were plugged in: of the device (vendor, product and its
# serial number), and of the socket it is plugged into.
NAMES_BY_DEVICE = Path("/dev/serial/by-id")
NAMES_BY_SOCKET = Path("/dev/serial/by-path")

# Files by which the places are known where a USB device does not appear by being plugged in.
KERNEL_RELEASE = Path("/proc/sys/kernel/osrelease")
BOARD_MODEL = Path("/proc/device-tree/model")
CONTAINER_MARKS = (Path("/.dockerenv"), Path("/run/.containerenv"))

UsbId = tuple[int, int]


@dataclass(frozen=True)
class Board:
    """Kind of board that leads to a servo bus."""

    usb_id: UsbId  # vendor and product id of its serial chip
    name: str  # chip and boards, for the reader
    certain: bool  # False for a chip that many devices other than servo boards have


# In order of certainty. Sources: the ids that public SO-101 projects list (phosphobot's so100.py and the constants of
# OpenCastor's so_arm101). The last three are the usual ids of chips that the makers name; no arm was seen behind them.
KNOWN_BOARDS = (
    Board((0x1A86, 0x55D3), "CH343: Waveshare Bus Servo Adapter A, Seeed and Feetech boards", certain=True),
    Board((0x1A86, 0x7523), "CH340: Feetech FE-URT-1", certain=True),
    Board((0x0483, 0x5740), "STM32: servo boards with a virtual COM port", certain=False),
    Board((0x303A, 0x1001), "ESP32-C3 or -S3: Seeed XIAO Bus Servo Adapter", certain=False),
    Board((0x10C4, 0xEA60), "CP210x: Waveshare Servo Driver with ESP32", certain=False),
    Board((0x0403, 0x6014), "FT232H: ROBOTIS U2D2", certain=False),
)


def usb_ports() -> list[ListPortInfo]:
    """Return the serial devices on USB, by name."""
    return sorted((info for info in list_ports.comports() if info.vid is not None), key=lambda info: info.device)


def usb_id_text(usb_id: UsbId) -> str:
    """Return a USB id as ``lsusb`` prints it."""
    return f"{usb_id[0]:04x}:{usb_id[1]:04x}"


def _only(port: str, found: Sequence[ListPortInfo]) -> str:
    if len(found) == 1:
        return _stable_name(found[0])
    numbers = [
        f"USB serial number {info.serial_number}" if info.serial_number else "no USB serial number" for info in found
    ]
    boards = " and ".join(
        f"{_stable_name(info)} ({usb_id_text((info.vid, info.pid))}, {number})"
        for info, number in zip(found, numbers, strict=True)
    )
    raise PortError(
        port, f"could be any of {len(found)} boards: {boards}; name one, as in --serial {_stable_name(found[0])}"
    )


def _stable_name(info: ListPortInfo) -> str:
    """Return the stable link to a device, or the device itself without one.

    Boards without a serial number, as those with a CH340, all have the same name by device: the link leads to the
    adapter plugged in last.
    """
    folders = (NAMES_BY_DEVICE, NAMES_BY_SOCKET) if info.serial_number else (NAMES_BY_SOCKET, NAMES_BY_DEVICE)
    device = os.path.realpath(info.device)
    for folder in folders:
        if folder.is_dir():
            for link in sorted(folder.iterdir()):
                if os.path.realpath(link) == device:
                    return str(link)
    return str(info.device)


def _explain_missing(plugged_in: Sequence[ListPortInfo]) -> str:
    if plugged_in:
        others = ", ".join(
            f"{info.device} ({usb_id_text((info.vid, info.pid))}, {info.product or 'without a name'})"
            for info in plugged_in
        )
        first = usb_id_text((plugged_in[0].vid, plugged_in[0].pid))
        return f"plugged in is {others}; if that leads to the servos, name it, as in --serial {first}"
    return f"no USB serial device is plugged in. {_advice_here()}"


def _advice_here() -> str:
    if "microsoft" in _text(KERNEL_RELEASE).lower():
        return "WSL 2 sees a USB device once Windows hands it over: usbipd attach --wsl --busid BUSID"
    if any(mark.exists() for mark in CONTAINER_MARKS):
        return "A container sees the devices that it was started with: docker run --device /dev/ttyACM0"
    if _text(BOARD_MODEL).startswith("Raspberry Pi"):
        return "A board on the pins of a Raspberry Pi is not found by USB: --serial /dev/serial0"
    return "Plug the board in with a cable that carries data, not power alone"


def _text(file: Path) -> str:
    try:
        return file.read_text(errors="replace")
    except OSError:
        return ""


AUTO = "auto"

BITS_PER_BYTE = 10  # start bit, eight data bits and stop bit

_USB_ID = re.compile(r"(?:usb:)?([0-9a-f]{4}):([0-9a-f]{4})", re.IGNORECASE)

# A sync write of 56 bytes takes 0.6 ms; an adapter that has not taken it in 100 ms is gone or stuck.
WRITE_TIMEOUT_S = 0.1

BLOCKING_READ_S = 0.004  # timeout of a read from a port without a file descriptor
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
    """Compute the time of bytes on the wire [s]."""
    return byte_count * BITS_PER_BYTE / baudrate


def resolve_port(port: str) -> str:
    """Find the device: a path or URL as it stands, or the one board of ``auto``, ``1a86:55d3`` or ``usb:1a86:55d3``."""
    named = _USB_ID.fullmatch(port)
    if port != AUTO and named is None:
        return port
    plugged_in = usb_ports()
    if named is None:
        choices = [{board.usb_id for board in KNOWN_BOARDS if board.certain is certain} for certain in (True, False)]
        problem = "found no known servo board"
    else:
        usb_id = int(named[1], 16), int(named[2], 16)
        choices, port, problem = [{usb_id}], usb_id_text(usb_id), "is the USB id of no serial device here"
    for usb_ids in choices:
        if found := [info for info in plugged_in if (info.vid, info.pid) in usb_ids]:
            return _only(port, found)
    raise PortError(port, f"{problem}: {_explain_missing(plugged_in)}")


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
        self._descriptor: int | None = None
        self._poll = select.poll()

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802 - the SDK's hook for opening the device
        """Open the device; the SDK calls this once it knows the baud rate."""
        self.closePort()
        self.ser = line = _open_line(self.port_name, cflag_baud)
        self.is_open = True
        self.is_using = False
        _ask_for_low_latency(line)
        with contextlib.suppress(io.UnsupportedOperation):
            self._descriptor = line.fileno()
            self._poll.register(self._descriptor, select.POLLIN)
            if os.path.realpath(self.port_name).startswith(PSEUDO_TERMINALS):
                self.latency_s, self.quiet_s = TERMINAL_LATENCY_S, TERMINAL_QUIET_S
            else:
                _claim(self._descriptor)
        return True

    def closePort(self) -> None:  # noqa: N802 - the SDK's name
        """Close the device, even if it is gone."""
        self.is_open = False
        if self._descriptor is not None:
            self._poll.unregister(self._descriptor)
            self._descriptor = None
        if self.ser is not None:
            with contextlib.suppress(OSError, termios.error):
                self.ser.close()
            self.ser = None

    def clearPort(self) -> None:  # noqa: N802 - the SDK calls this before it writes
        """Discard the input that has arrived."""
        for _ in range(MAX_CLEARING_READS):
            stale = self.receive(0.0)
            if not stale:
                break
            self.discarded_bytes += len(stale)

    def writePort(self, packet: Sequence[int]) -> int:  # noqa: N802 - the SDK calls this to write
        """Write a packet; return the number of bytes written."""
        data = bytes(packet)
        try:
            written = self._write_at_once(data)
            if written < len(data):
                # pyserial waits until the device takes more, for WRITE_TIMEOUT_S at most.
                written += self._open_line().write(data[written:]) or 0
        except DEVICE_ERRORS as error:
            raise PortLost(self.port_name, str(error)) from error
        return written

    def receive(self, timeout_s: float) -> bytes:
        """Return bytes as soon as some have arrived; none after ``timeout_s`` [s]."""
        try:
            if self._descriptor is None:
                return self._receive_blocking(timeout_s)
            if not self._poll.poll(timeout_s * 1000.0):
                return b""
            data = os.read(self._descriptor, READ_BYTES)
        except BlockingIOError:
            return b""
        except DEVICE_ERRORS as error:
            raise PortLost(self.port_name, str(error)) from error
        if not data:
            raise PortLost(self.port_name, "the other end closed it")
        return data

    def _write_at_once(self, data: bytes) -> int:
        if self._descriptor is None:
            return 0
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            return 0

    def _receive_blocking(self, timeout_s: float) -> bytes:
        line = self._open_line()
        deadline = time.monotonic() + timeout_s
        while True:
            if waiting := line.in_waiting:
                return line.read(waiting)
            if time.monotonic() >= deadline:
                return b""
            if first := line.read(1):
                return first

    def _open_line(self) -> serial.Serial:
        if self.ser is None:
            raise PortLost(self.port_name, "it is not open")
        return self.ser


def _open_line(port: str, baudrate: int) -> serial.Serial:
    try:
        return serial.serial_for_url(
            port, baudrate=baudrate, timeout=BLOCKING_READ_S, write_timeout=WRITE_TIMEOUT_S, exclusive=True
        )
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


def _ask_for_low_latency(line: serial.Serial) -> None:
    """Ask the kernel not to collect input for 16 ms, as FTDI's driver does; other drivers reject this, and need not."""
    with contextlib.suppress(ValueError, NotImplementedError, AttributeError):
        line.set_low_latency_mode(True)
