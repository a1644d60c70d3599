"""Limits of rates, and the key under which the actions of one machine count."""

from ipaddress import IPv4Address, IPv6Address, ip_address

# The owner of one IPv6 address has its whole network (RFC 6177: at least a /64 a site).
IPV6_PREFIX_BITS = 64


class RateLimiter:
    """Token bucket: a burst at once, and a rate in the long run [1/s]."""

    # Every client has some of them.
    __slots__ = ("_counted_s", "_left", "burst", "per_s")

    def __init__(self, per_s: float, burst: int) -> None:
        self.per_s = per_s
        self.burst = burst
        self._left = float(burst)
        self._counted_s = 0.0

    def take(self, now_s: float) -> bool:
        """Take one at a monotonic time [s]; return False when none is left."""
        self._left = min(float(self.burst), self._left + (now_s - self._counted_s) * self.per_s)
        self._counted_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


def parse_address(text: str) -> IPv4Address | IPv6Address | None:
    try:
        return ip_address(text)
    except ValueError:
        return None


def is_loopback(address: str) -> bool:
    """Return True for an IP address that only this machine reaches."""
    known = parse_address(address)
    return known is not None and known.is_loopback


def client_key(address: str) -> str:
    """Return the key under which a client counts: its IP address, or the network (/64) of an IPv6 address."""
    known = parse_address(address)
    if isinstance(known, IPv6Address):
        if known.ipv4_mapped is not None:
            return str(known.ipv4_mapped)
        if not known.is_loopback:
            network = int(known) >> (128 - IPV6_PREFIX_BITS) << (128 - IPV6_PREFIX_BITS)
            return f"{IPv6Address(network)}/{IPV6_PREFIX_BITS}"
    return address if known is None else str(known)
