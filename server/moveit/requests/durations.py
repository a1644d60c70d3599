"""Times and durations in requests, as builtin_interfaces has them."""

from __future__ import annotations

from server.moveit.poses import Message
from server.moveit.requests.error_codes import invalid

NANOSECONDS_PER_S = 1_000_000_000


def read_seconds(message: Message, where: str) -> float:
    """Read a builtin_interfaces/Duration or Time [s].

    Args:
        message: the duration or time.
        where: path of its field, for errors.

    Raises:
        RefusedError: its nanoseconds are a second or more.
    """
    nanosec: int = message["nanosec"]
    if nanosec >= NANOSECONDS_PER_S:
        raise invalid(f"{where}.nanosec must be below {NANOSECONDS_PER_S}, not {nanosec}", field=f"{where}.nanosec")
    return float(message["sec"]) + nanosec / NANOSECONDS_PER_S
