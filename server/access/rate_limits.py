"""Limits of rates: of actions, of log lines, and the key under which the actions of one machine count."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from ipaddress import IPv4Address, IPv6Address, ip_address

from protocol.errors import one_line, shorten

# The owner of one IPv6 address has its whole network (RFC 6177: at least a /64 a site).
IPV6_PREFIX_BITS = 64

# Refusals that the log is told of by one part of the server; the refused choose what they are about.
MAX_REFUSAL_LINES = 100


class RateLimiter:
    """Token bucket: so many at once, and so many in the long run.

    Args:
        per_s: rate in the long run [1/s]; 0 for no more than the burst, ever.
        burst: number at once.
    """

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


class LogLimiter:
    """Bound on the log lines about one subject, so that no client can fill the disk with them.

    A line may have a key: lines of one key are written once. Lines that were left out are counted, and told with the
    next one that is written; where there can be no next one, the first that is left out is replaced by a note.

    Args:
        log: where the lines go.
        burst: lines at once.
        per_s: lines in the long run [1/s].
        clock: monotonic time [s].
    """

    __slots__ = ("_clock", "_keys", "_left_out", "_log", "_rate")

    def __init__(
        self, log: logging.Logger, burst: int, per_s: float = 0.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._log = log
        self._rate = RateLimiter(per_s, burst)
        self._clock = clock
        self._left_out = 0
        # Its size is bounded by the burst: a key is remembered when its line is written.
        self._keys: set[tuple[str, str]] = set()

    def write(self, level: int, line: str, key: tuple[str, str] | None = None) -> None:
        """Write a line, unless there were too many.

        Args:
            level: of logging.
            line: text; control characters in it are escaped.
            key: kind and value of the subject, of which one line is enough; None for a line that may be repeated.
        """
        if key is not None:
            key = key[0], shorten(key[1])
            if key in self._keys:
                return
        if not self._rate.take(self._clock()):
            self._leave_out(level)
            return
        if key is not None:
            self._keys.add(key)
        left_out, self._left_out = self._left_out, 0
        more = f" ({left_out} more lines about this client were left out before)" if left_out else ""
        self._log.log(level, "%s%s", one_line(line), more)

    def _leave_out(self, level: int) -> None:
        self._left_out += 1
        if self._left_out == 1 and self._rate.per_s == 0.0:
            self._log.log(level, "%d lines of this kind were written; further ones are not", self._rate.burst)


def parse_address(text: str) -> IPv4Address | IPv6Address | None:
    """Return an IP address, None for any other text."""
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
