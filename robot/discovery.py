"""Finding the serial port of the arm's USB adapter."""

from __future__ import annotations

from serial.tools import list_ports

from robot.errors import PortError

AUTO = "auto"

# CH343 of the Waveshare Bus Servo Adapter A, and CH340 of the FE-URT-1.
ADAPTERS = frozenset({(0x1A86, 0x55D3), (0x1A86, 0x7523)})


def resolve_port(port: str) -> str:
    """The device to open: ``port`` itself, or the one adapter plugged in when it is ``auto``.

    Raises:
        PortError: ``auto`` found no adapter, or more than one.
    """
    if port != AUTO:
        return port
    found = [info.device for info in list_ports.comports() if (info.vid, info.pid) in ADAPTERS]
    if len(found) == 1:
        return str(found[0])
    known = ", ".join(f"{vid:04x}:{pid:04x}" for vid, pid in sorted(ADAPTERS))
    problem = f"is ambiguous among {', '.join(found)}: name one" if found else "found no servo adapter plugged in"
    raise PortError(AUTO, f"{problem} (USB ids {known})")
