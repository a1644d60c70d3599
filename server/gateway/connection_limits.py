"""Limits of connections: in all, from one address, and their rate.

A connection counts from the moment websockets is told of it: when the TCP connection is made, and with TLS when the
handshake is done.
"""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus

from server.access.rate_limits import MAX_REFUSAL_LINES, LogLimiter, RateLimiter, client_key

log = logging.getLogger("armbridge.gateway")

# Connections at once from an address: those of this time at the rate [s].
BURST_TIME_S = 10

# Refused connections are answered with the reason while they are few: an answer costs a handshake, and a flood gets
# none.
MAX_ANSWERED = 32
ANSWERS_PER_S = 10

# Addresses without a connection that are remembered, for their rate.
MAX_ABSENT = 10_000

RETRY_AFTER_S = 5


@dataclass(frozen=True)
class ConnectionLimits:
    """Limits of connections.

    Attributes:
        max_clients: at a time.
        max_clients_per_address: at a time, from one address.
        connections_per_s: new ones from one address, in the long run [1/s].
    """

    max_clients: int = 1000
    max_clients_per_address: int = 800
    connections_per_s: float = 100.0


@dataclass(frozen=True)
class Rejection:
    """Answer to a connection that is one too many.

    Attributes:
        status: of HTTP.
        sentence: the reason, with the setting to change.
    """

    status: HTTPStatus
    sentence: str


class ConnectionSlot:
    """Place of one connection, from its beginning to its end.

    Attributes:
        address: where it comes from.
        rejection: the answer that ends it; None for a connection that may stay.
    """

    __slots__ = ("_release", "address", "rejection")

    def __init__(self, address: str, rejection: Rejection | None, release: Callable[[], None]) -> None:
        self.address = address
        self.rejection = rejection
        self._release: Callable[[], None] | None = release

    def release(self) -> None:
        """Free the place; once is enough."""
        if self._release is not None:
            release, self._release = self._release, None
            release()


class _Address:
    """Connections and rate of one address."""

    __slots__ = ("open_count", "rate")

    def __init__(self, rate: RateLimiter) -> None:
        self.open_count = 0
        self.rate = rate


class ConnectionLimiter:
    """Counter of connections.

    Args:
        limits: the limits of connections.

    Attributes:
        rejected_count: connections that were one too many.
        open_count: connections that may stay.
    """

    def __init__(self, limits: ConnectionLimits | None = None) -> None:
        self.rejected_count = 0
        self.open_count = 0
        self._limits = limits or ConnectionLimits()
        # Addresses with connections, and those without, the one that left last at the end.
        self._present: dict[str, _Address] = {}
        self._absent: OrderedDict[str, _Address] = OrderedDict()
        self._answered = 0
        self._answers = RateLimiter(ANSWERS_PER_S, ANSWERS_PER_S)
        self._log = LogLimiter(log, MAX_REFUSAL_LINES)

    def acquire(self, address: str, now_s: float) -> ConnectionSlot | None:
        """Count a connection.

        Args:
            address: IP address that it comes from.
            now_s: monotonic time [s].

        Returns:
            Its place, to be released with the connection; None for a connection to be closed without an answer.
        """
        key = client_key(address)
        known = self._address(key)
        rejection = self._rejection(known, now_s)
        if rejection is None:
            self._present[key] = known
            known.open_count += 1
            self.open_count += 1
            return ConnectionSlot(address, None, lambda: self._leave(key, known))
        self.rejected_count += 1
        if not known.open_count:
            self._remember(key, known)
        if self._answered >= MAX_ANSWERED or not self._answers.take(now_s):
            return None
        self._answered += 1
        self._log.write(logging.WARNING, f"refused: {address}: {rejection.sentence}", ("connection", address))
        return ConnectionSlot(address, rejection, self._end_answer)

    def _address(self, key: str) -> _Address:
        known = self._present.get(key) or self._absent.pop(key, None)
        per_s = self._limits.connections_per_s
        return known or _Address(RateLimiter(per_s, int(BURST_TIME_S * per_s)))

    def _rejection(self, known: _Address, now_s: float) -> Rejection | None:
        limits = self._limits
        if not known.rate.take(now_s):
            limit = f"{limits.connections_per_s:g} a second (server.connections_per_s)"
            return Rejection(HTTPStatus.TOO_MANY_REQUESTS, f"new connections come too often; the limit is {limit}")
        if known.open_count >= limits.max_clients_per_address:
            limit = f"{limits.max_clients_per_address} (server.max_clients_per_address)"
            sentence = f"{known.open_count} connections are open from this address, the limit is {limit}"
            return Rejection(HTTPStatus.TOO_MANY_REQUESTS, sentence)
        if self.open_count >= limits.max_clients:
            sentence = f"{self.open_count} connections are open, the limit is {limits.max_clients} (server.max_clients)"
            return Rejection(HTTPStatus.SERVICE_UNAVAILABLE, sentence)
        return None

    def _leave(self, key: str, known: _Address) -> None:
        self.open_count -= 1
        known.open_count -= 1
        if not known.open_count:
            del self._present[key]
            self._remember(key, known)

    def _remember(self, key: str, known: _Address) -> None:
        self._absent[key] = known
        self._absent.move_to_end(key)
        if len(self._absent) > MAX_ABSENT:
            self._absent.popitem(last=False)

    def _end_answer(self) -> None:
        self._answered -= 1
