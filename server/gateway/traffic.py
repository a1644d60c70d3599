"""What all clients together say and hear, those who have left included."""

from __future__ import annotations

from typing import NamedTuple, Protocol


class TrafficCounts(NamedTuple):
    """Counts of one connection, or of all of them.

    Attributes:
        received_messages: WebSocket messages that came.
        received_bytes: what came over the connection, its handshake included.
        sent_messages: WebSocket messages that went; a fragment is one.
        sent_bytes: what they took on the connection.
        dropped_messages: topic data given up because it was read too slowly.
        refused_operations: what was not carried out.
    """

    received_messages: int = 0
    received_bytes: int = 0
    sent_messages: int = 0
    sent_bytes: int = 0
    dropped_messages: int = 0
    refused_operations: int = 0


class Counted(Protocol):
    """A connection, which counts for itself."""

    def counts(self) -> TrafficCounts:
        """What it has said and heard until now."""

    @property
    def queued_bytes(self) -> int:
        """What waits for it to read."""


class Traffic:
    """Adds up connections when somebody asks; nothing is done here for each message.

    Attributes:
        connections: how many there have ever been.
    """

    def __init__(self) -> None:
        self.connections = 0
        self._open: set[Counted] = set()
        self._of_those_who_left = TrafficCounts()

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._open)

    def add(self, connection: Counted) -> None:
        """A client has connected."""
        self.connections += 1
        self._open.add(connection)

    def remove(self, connection: Counted) -> None:
        """A client has left."""
        self._open.discard(connection)
        self._of_those_who_left = _sum([self._of_those_who_left, connection.counts()])

    def counts(self) -> TrafficCounts:
        """Of all clients, from the first on."""
        return _sum([self._of_those_who_left, *(connection.counts() for connection in self._open)])

    def queued_bytes(self) -> tuple[int, int]:
        """What waits for all clients, and for the one for whom most does."""
        queued = [connection.queued_bytes for connection in self._open]
        return sum(queued), max(queued, default=0)


def _sum(counts: list[TrafficCounts]) -> TrafficCounts:
    return TrafficCounts(*map(sum, zip(*counts, strict=True)))
