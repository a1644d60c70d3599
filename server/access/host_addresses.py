"""Addresses of this machine in its networks, without a look-up of names."""

from __future__ import annotations

import fcntl
import socket
import struct
from collections.abc import Sequence
from ipaddress import IPv6Address
from pathlib import Path

# ioctl(2) of netdevice(7): the IPv4 address of an interface.
_SIOCGIFADDR = 0x8915

# proc(5): one line an address, of 32 digits, index, prefix length, scope and flags, all in hexadecimal, and the name.
_IPV6_TABLE = Path("/proc/net/if_inet6")
_GLOBAL_SCOPE = "00"
_IPV6_FIELDS = 6


def host_addresses() -> Sequence[str]:
    """Return the addresses at which other machines may reach this one: IPv4 first, no loopback or link-local."""
    return [*_ipv4_addresses(), *_ipv6_addresses(_read_table())]


def _ipv4_addresses() -> list[str]:
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[:15])
            try:
                answer = fcntl.ioctl(asked.fileno(), _SIOCGIFADDR, request)
            except OSError:
                # An interface without an IPv4 address.
                continue
            found.append(socket.inet_ntoa(answer[20:24]))
    return [address for address in found if not address.startswith(("127.", "169.254."))]


def _read_table() -> str:
    try:
        return _IPV6_TABLE.read_text()
    except OSError:
        # A kernel without IPv6.
        return ""


def _ipv6_addresses(table: str) -> list[str]:
    lines = [line.split() for line in table.splitlines()]
    found = [fields[0] for fields in lines if len(fields) == _IPV6_FIELDS and fields[3] == _GLOBAL_SCOPE]
    return [str(IPv6Address(bytes.fromhex(digits))) for digits in found]
