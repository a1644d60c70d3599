"""Addresses of machines and the names for them, as they stand in HTTP headers."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fnmatch import fnmatchcase
from ipaddress import IPv4Address, IPv6Address, ip_address

MAX_PORT = 65_535

# Whoever has one IPv6 address of a network has all of them.
IPV6_PREFIX_BITS = 64

_AUTHORITY = re.compile(
    r"(?:\[(?P<ipv6>[0-9A-Fa-f:.]{2,45})(?:%[0-9A-Za-z._~-]{1,32})?\]|(?P<name>[0-9A-Za-z_.-]{1,255}))"
    r"(?::(?P<port>[0-9]{1,5}))?"
)


@dataclass(frozen=True)
class Authority:
    """Host and port as a header names them.

    Attributes:
        host: a name in lower case without the dot at its end, or an IP address without brackets.
        port: TCP port; None for that of the scheme.
    """

    host: str
    port: int | None = None

    @property
    def address(self) -> IPv4Address | IPv6Address | None:
        """The host as an IP address; None for a name."""
        return _address(self.host)

    @property
    def is_loopback(self) -> bool:
        """Whether it is this machine, by address or as ``localhost``."""
        address = self.address
        return self.host == "localhost" if address is None else address.is_loopback


def read_authority(text: str) -> Authority | None:
    """Host and port from a header; None for anything else, such as one with a user in it."""
    found = _AUTHORITY.fullmatch(text)
    if found is None:
        return None
    port = None if found["port"] is None else int(found["port"])
    if port is not None and port > MAX_PORT:
        return None
    if found["ipv6"] is not None:
        address = _address(found["ipv6"])
        return Authority(str(address), port) if isinstance(address, IPv6Address) else None
    # The dot marks a name as complete; it is no other name for that.
    host = found["name"].lower().removesuffix(".")
    return Authority(host, port) if host and not host.endswith(".") else None


def matches(text: str, pattern: str) -> bool:
    """Whether a pattern is for a text; ``*`` stands for any, and brackets for themselves, as IPv6 addresses need."""
    return fnmatchcase(text, pattern.replace("[", "[[]"))


def peer(address: str) -> str:
    """Under what a client is counted that comes from an address: the address, or the network of an IPv6 one."""
    known = _address(address)
    if isinstance(known, IPv6Address):
        if known.ipv4_mapped is not None:
            return str(known.ipv4_mapped)
        if not known.is_loopback:
            network = int(known) >> (128 - IPV6_PREFIX_BITS) << (128 - IPV6_PREFIX_BITS)
            return f"{IPv6Address(network)}/{IPV6_PREFIX_BITS}"
    return address if known is None else str(known)


def is_loopback(address: str) -> bool:
    """Whether only this machine reaches an IP address."""
    known = _address(address)
    return known is not None and known.is_loopback


def _address(text: str) -> IPv4Address | IPv6Address | None:
    try:
        return ip_address(text)
    except ValueError:
        return None
