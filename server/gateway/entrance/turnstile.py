"""How many may be connected, in all and from one address, and how often one may come.

A connection counts from the moment websockets is told of it: the TCP connection is made, and with TLS the handshake.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus

from server.access.rates import Rate
from server.gateway.entrance.addresses import peer
from server.gateway.entrance.refusal_log import RefusalLog

# What may come at once from an address, as time over which the rate holds.
BURST_TIME_S = 10

# Who is one too many hears why, if there are few of them: an answer costs a handshake, and a flood gets none.
MAX_ANSWERED = 32
ANSWERS_PER_S = 10

# Addresses without a connection that are remembered, for their rate.
MAX_ABSENT = 10_000

RETRY_AFTER_S = 5


@dataclass(frozen=True)
class ConnectionLimits:
    """How many connections there may be.

    Attributes:
        max_clients: at a time.
        max_clients_per_address: at a time, from one address.
        connections_per_s: new ones from one address, in the long run [1/s].
    """

    max_clients: int = 1000
    max_clients_per_address: int = 800
    connections_per_s: float = 100.0


@dataclass(frozen=True)
class TurnedAway:
    """Why a connection is refused.

    Attributes:
        status: of the answer.
        sentence: what there is to say, with the setting to change.
    """

    status: HTTPStatus
    sentence: str


class Visit:
    """One connection, from its beginning to its end.

    Attributes:
        address: where it comes from.
        turned_away: why it is only there to be told that it may not stay; None for one that may.
    """

    __slots__ = ("_end", "address", "turned_away")

    def __init__(self, address: str, turned_away: TurnedAway | None, end: Callable[[], None]) -> None:
        self.address = address
        self.turned_away = turned_away
        self._end: Callable[[], None] | None = end

    def end(self) -> None:
        """Make room for another one; once is enough."""
        if self._end is not None:
            ending, self._end = self._end, None
            ending()


class _Visitor:
    """What is known of an address."""

    __slots__ = ("present", "rate")

    def __init__(self, rate: Rate) -> None:
        self.present = 0
        self.rate = rate


class Turnstile:
    """Counts connections.

    Args:
        limits: how many there may be.

    Attributes:
        turned_away: how many were one too many.
    """

    def __init__(self, limits: ConnectionLimits | None = None) -> None:
        self.turned_away = 0
        self._limits = limits or ConnectionLimits()
        # Those that are present, and those that are not, the one that left last at the end.
        self._visitors: dict[str, _Visitor] = {}
        self._absent: OrderedDict[str, _Visitor] = OrderedDict()
        self._present = 0
        self._answered = 0
        self._answers = Rate(ANSWERS_PER_S, ANSWERS_PER_S)
        self._log = RefusalLog()

    @property
    def present(self) -> int:
        """Connections that may stay."""
        return self._present

    def enter(self, address: str, now_s: float) -> Visit | None:
        """Take a connection in.

        Args:
            address: where it comes from.
            now_s: monotonic time [s].

        Returns:
            The visit, to be ended with the connection; None for one to be closed without an answer.
        """
        key = peer(address)
        visitor = self._visitor(key)
        turned_away = self._refusal(visitor, now_s)
        if turned_away is None:
            self._visitors[key] = visitor
            visitor.present += 1
            self._present += 1
            return Visit(address, None, lambda: self._leave(key, visitor))
        self.turned_away += 1
        if not visitor.present:
            self._remember(key, visitor)
        if self._answered >= MAX_ANSWERED or not self._answers.take(now_s):
            return None
        self._answered += 1
        self._log.tell("connections", address, f"{address}: {turned_away.sentence}")
        return Visit(address, turned_away, self._answer_given)

    def _visitor(self, key: str) -> _Visitor:
        known = self._visitors.get(key) or self._absent.pop(key, None)
        per_s = self._limits.connections_per_s
        return known or _Visitor(Rate(per_s, int(BURST_TIME_S * per_s)))

    def _refusal(self, visitor: _Visitor, now_s: float) -> TurnedAway | None:
        limits = self._limits
        if not visitor.rate.take(now_s):
            limit = f"{limits.connections_per_s:g} a second (server.connections_per_s)"
            return TurnedAway(HTTPStatus.TOO_MANY_REQUESTS, f"new connections come too often; the limit is {limit}")
        if visitor.present >= limits.max_clients_per_address:
            limit = f"{limits.max_clients_per_address} (server.max_clients_per_address)"
            sentence = f"{visitor.present} connections are open from this address, the limit is {limit}"
            return TurnedAway(HTTPStatus.TOO_MANY_REQUESTS, sentence)
        if self._present >= limits.max_clients:
            sentence = f"{self._present} connections are open, the limit is {limits.max_clients} (server.max_clients)"
            return TurnedAway(HTTPStatus.SERVICE_UNAVAILABLE, sentence)
        return None

    def _leave(self, key: str, visitor: _Visitor) -> None:
        self._present -= 1
        visitor.present -= 1
        if not visitor.present:
            del self._visitors[key]
            self._remember(key, visitor)

    def _remember(self, key: str, visitor: _Visitor) -> None:
        self._absent[key] = visitor
        self._absent.move_to_end(key)
        if len(self._absent) > MAX_ABSENT:
            self._absent.popitem(last=False)

    def _answer_given(self) -> None:
        self._answered -= 1
