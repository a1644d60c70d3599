"""Servo boards that are known by their USB id, and the choice of the one to open; what cannot be chosen is explained.

A USB id names the board's serial chip, not the board, so the table has two classes. Chips of the boards that servo arms
are sold with come first. Chips that a few servo boards share with many other devices are taken only where no board of
the first class is plugged in.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from robot.errors import PortError

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


def find_board() -> str:
    """Return the device of the one known board that is plugged in; raises PortError for none and for several."""
    plugged_in = usb_ports()
    for certain in (True, False):
        usb_ids = {board.usb_id for board in KNOWN_BOARDS if board.certain is certain}
        found = [info for info in plugged_in if (info.vid, info.pid) in usb_ids]
        if found:
            return _only("auto", found)
    raise PortError("auto", f"found no known servo board: {_explain_missing(plugged_in)}")


def find_usb_id(usb_id: UsbId) -> str:
    """Return the one device with a USB id; raises PortError for none and for several."""
    plugged_in = usb_ports()
    found = [info for info in plugged_in if (info.vid, info.pid) == usb_id]
    name = usb_id_text(usb_id)
    if not found:
        raise PortError(name, f"is the USB id of no serial device here: {_explain_missing(plugged_in)}")
    return _only(name, found)


def usb_ports() -> list[ListPortInfo]:
    """Return the serial devices on USB, by name."""
    return sorted((info for info in list_ports.comports() if info.vid is not None), key=lambda info: info.device)


def usb_id_text(usb_id: UsbId) -> str:
    """Return a USB id as ``lsusb`` prints it."""
    return f"{usb_id[0]:04x}:{usb_id[1]:04x}"


def _only(port: str, found: Sequence[ListPortInfo]) -> str:
    if len(found) == 1:
        return _stable_name(found[0])
    boards = " and ".join(f"{_stable_name(info)} ({_describe(info)})" for info in found)
    raise PortError(
        port, f"could be any of {len(found)} boards: {boards}; name one, as in --serial {_stable_name(found[0])}"
    )


def _describe(info: ListPortInfo) -> str:
    number = f"USB serial number {info.serial_number}" if info.serial_number else "no USB serial number"
    return f"{usb_id_text((info.vid, info.pid))}, {number}"


def _stable_name(info: ListPortInfo) -> str:
    """Return the stable link to a device, or the device itself without one.

    Boards without a serial number, as those with a CH340, all have the same name by device: the link leads to the one
    that was plugged in last.
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
