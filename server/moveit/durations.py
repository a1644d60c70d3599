"""Times and durations in requests, as builtin_interfaces has them."""

from __future__ import annotations

from server.moveit.error_codes import invalid
from server.moveit.poses import Message

NANOSECONDS_PER_S = 1_000_000_000


def read_seconds(message: Message, where: str) -> float:
    """Read a builtin_interfaces/Duration or Time [s]."""
    nanosec: int = message["nanosec"]
    if nanosec >= NANOSECONDS_PER_S:
        raise invalid(f"{where}.nanosec must be below {NANOSECONDS_PER_S}, not {nanosec}", field=f"{where}.nanosec")
    return float(message["sec"]) + nanosec / NANOSECONDS_PER_S
