"""What a client has registered, topic by topic: several ids on one topic, under one limit."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Generic, TypeVar

from protocol.errors import NothingToDoError, OperationError, describe
from protocol.names import qualify
from protocol.operations import Advertise

T = TypeVar("T")


class Registrations(Generic[T]):
    """A table topic -> id -> entry, in which a topic has one key however it is spelled.

    Args:
        op: the operation that registers, for errors.
        opposite: the operation that withdraws, likewise.
        limit: greatest number of entries, over all topics.
    """

    def __init__(self, op: str, opposite: str, limit: int) -> None:
        self._op = op
        self._opposite = opposite
        self._limit = limit
        self._count = 0
        self._entries: dict[str, dict[str | int | None, T]] = {}

    def __iter__(self) -> Iterator[str]:
        """Go over the topics, by fully qualified name; the table may change meanwhile."""
        return iter(list(self._entries))

    def __contains__(self, topic: str) -> bool:
        return qualify(topic) in self._entries

    def entries(self, topic: str) -> Collection[T]:
        """Return the entries of all ids on a topic."""
        return self._entries.get(qualify(topic), {}).values()

    def put(self, topic: str, entry_id: str | int | None, entry: T) -> bool:
        """Register an entry; the same id on the same topic is replaced.

        Returns:
            True when this is the first entry on the topic.

        Raises:
            OperationError: the limit is reached.
        """
        # A refused entry must leave no empty topic behind, so the topic is made only afterwards.
        if entry_id not in self._entries.get(qualify(topic), {}):
            if self._count >= self._limit:
                raise OperationError(self._op, None, f"this client has {self._count}, the limit is {self._limit}")
            self._count += 1
        ids = self._entries.setdefault(qualify(topic), {})
        first = not ids
        ids[entry_id] = entry
        return first

    def remove(self, topic: str, entry_id: str | int | None) -> bool:
        """Withdraw one entry, or all on the topic when no id is given.

        Returns:
            True when nothing is left on the topic.

        Raises:
            NothingToDoError: there is no such entry.
        """
        ids = self._entries.get(qualify(topic), {})
        withdrawn = list(ids) if entry_id is None else [one for one in ids if one == entry_id]
        if not withdrawn:
            what = f"topic {topic}" if entry_id is None else f"topic {topic} under id {describe(entry_id)}"
            raise NothingToDoError(self._opposite, None, f"{what}: this client has no {self._op} of it")
        for one in withdrawn:
            del ids[one]
        self._count -= len(withdrawn)
        if not ids:
            del self._entries[qualify(topic)]
        return not ids


class Publications(Registrations[None]):
    """The topics a client has advertised.

    Args:
        limit: greatest number of registrations, over all topics and ids.
    """

    def __init__(self, limit: int) -> None:
        super().__init__("advertise", "unadvertise", limit)

    def add(self, operation: Advertise) -> bool:
        """Register the client as a publisher, after the graph has accepted the operation.

        Returns:
            True when this is the client's first registration on the topic.

        Raises:
            OperationError: the client's limit is reached.
        """
        return self.put(operation.topic, operation.id, None)
