"""Finding the serial port of the arm's USB adapter, under whatever name it was asked for."""

from __future__ import annotations

import re
from pathlib import Path

from serial.tools import list_ports

from robot.errors import PortError

AUTO = "auto"

# CH343 of the Waveshare Bus Servo Adapter A, and CH340 of the FE-URT-1.
ADAPTERS = frozenset({(0x1A86, 0x55D3), (0x1A86, 0x7523)})

# Names that stay the same when the adapter is plugged in anew, or after another one.
STABLE_NAMES = Path("/dev/serial/by-id")

_USB_ID = re.compile(r"(?:usb:)?([0-9a-f]{4}):([0-9a-f]{4})", re.IGNORECASE)


def resolve_port(port: str) -> str:
    """The device to open.

    Args:
        port: a path or URL, which is taken as it is; ``auto`` for the one adapter plugged in; or the USB id of an
            adapter, as ``1a86:55d3`` or ``usb:1a86:55d3``.

    Raises:
        PortError: no such adapter is plugged in, or more than one.
    """
    if port == AUTO:
        return _only(port, ADAPTERS)
    if usb_id := _USB_ID.fullmatch(port):
        return _only(port, frozenset({(int(usb_id[1], 16), int(usb_id[2], 16))}))
    return port


def _only(port: str, usb_ids: frozenset[tuple[int, int]]) -> str:
    found = [_stable_name(info.device) for info in list_ports.comports() if (info.vid, info.pid) in usb_ids]
    if len(found) == 1:
        return found[0]
    known = ", ".join(f"{vid:04x}:{pid:04x}" for vid, pid in sorted(usb_ids))
    problem = f"is ambiguous among {', '.join(found)}: name one" if found else "found no servo adapter plugged in"
    raise PortError(port, f"{problem} (USB ids {known})")


def _stable_name(device: str) -> str:
    """The link to a device that keeps its name, if there is one."""
    if STABLE_NAMES.is_dir():
        for link in sorted(STABLE_NAMES.iterdir()):
            if link.resolve() == Path(device).resolve():
                return str(link)
    return device
