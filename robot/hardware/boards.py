"""Serial port of the servo board by its device, its USB id, or ``auto``.

A USB id names the board's serial chip, not the board: chips of the boards that servo arms are sold with come first;
chips that a few servo boards share with other devices are taken only where no board of the first class is plugged in.
"""

import os
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from robot.errors import PortError

AUTO = "auto"

_USB_ID = re.compile(r"(?:usb:)?([0-9a-f]{4}):([0-9a-f]{4})", re.IGNORECASE)

# Device names that do not depend on the order in which boards were plugged in: of the device (vendor, product and its
# serial number), and of the socket it is plugged into.
NAMES_BY_DEVICE = Path("/dev/serial/by-id")
NAMES_BY_SOCKET = Path("/dev/serial/by-path")

# Files by which the places are known where a USB device does not appear by being plugged in.
KERNEL_RELEASE = Path("/proc/sys/kernel/osrelease")
BOARD_MODEL = Path("/proc/device-tree/model")
CONTAINER_MARKS = (Path("/.dockerenv"), Path("/run/.containerenv"))

UsbId = tuple[int, int]


# Serial chips and their boards, in order of certainty. Sources: the ids that public SO-101 projects list (phosphobot's
# so100.py and the constants of OpenCastor's so_arm101).
SERVO_BOARDS: Mapping[UsbId, str] = {
    (0x1A86, 0x55D3): "CH343: Waveshare Bus Servo Adapter A, Seeed and Feetech boards",
    (0x1A86, 0x7523): "CH340: Feetech FE-URT-1",
}

# Chips that many other devices have as well. The last three are the usual ids of chips that the makers name; no arm was
# seen behind them.
SHARED_CHIPS: Mapping[UsbId, str] = {
    (0x0483, 0x5740): "STM32: servo boards with a virtual COM port",
    (0x303A, 0x1001): "ESP32-C3 or -S3: Seeed XIAO Bus Servo Adapter",
    (0x10C4, 0xEA60): "CP210x: Waveshare Servo Driver with ESP32",
    (0x0403, 0x6014): "FT232H: ROBOTIS U2D2",
}


def usb_id_text(usb_id: UsbId) -> str:
    """Return a USB id as ``lsusb`` prints it."""
    return f"{usb_id[0]:04x}:{usb_id[1]:04x}"


def _single_board(port: str, found: Sequence[ListPortInfo]) -> str:
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


def resolve_port(port: str) -> str:
    """Find the device: a path or URL as it stands, or the one board of ``auto``, ``1a86:55d3`` or ``usb:1a86:55d3``."""
    named = _USB_ID.fullmatch(port)
    if port != AUTO and named is None:
        return port
    plugged_in = sorted((info for info in list_ports.comports() if info.vid), key=lambda info: info.device)
    if named is None:
        choices: list[Collection[UsbId]] = [SERVO_BOARDS, SHARED_CHIPS]
        problem = "found no known servo board"
    else:
        usb_id = int(named[1], 16), int(named[2], 16)
        choices, port, problem = [{usb_id}], usb_id_text(usb_id), "is the USB id of no serial device here"
    for usb_ids in choices:
        if found := [info for info in plugged_in if (info.vid, info.pid) in usb_ids]:
            return _single_board(port, found)
    raise PortError(port, f"{problem}: {_explain_missing(plugged_in)}")
