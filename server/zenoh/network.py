"""What the parts of the bridge have in common: the session, the names, and a log that does not repeat itself."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeAlias

from protocol import type_hash
from protocol.errors import InterfaceError
from protocol.registry import Registry
from server.graph.node import Node
from server.graph.topics import Graph
from server.zenoh.keys import Endpoint, Tokens
from server.zenoh.names import Namespace
from server.zenoh.session_thread import SessionThread

log = logging.getLogger("armbridge.zenoh")

SharedKind: TypeAlias = Literal["msg", "srv"]

_HASHES: Mapping[SharedKind, Callable[[Registry, str], str]] = {
    "msg": type_hash.message_hash,
    "srv": type_hash.service_hash,
}

# Whoever invents names at the other end must not fill the log.
MAX_TOLD = 200

# Shared topics and services each, in each direction: more than a large robot has.
MAX_SHARED = 1_000


class Declared(Protocol):
    """What others know of until it is taken back."""

    def undeclare(self) -> object:
        """Take it back."""


def undeclare(*declared: Declared | None) -> None:
    """Take back what has been declared; in the thread of the session."""
    for each in declared:
        if each is not None:
            each.undeclare()


class Told:
    """Warns of everything once."""

    def __init__(self) -> None:
        self._told: set[str] = set()

    def warn(self, text: str) -> None:
        """Write a warning that has not been written yet."""
        if text not in self._told and len(self._told) < MAX_TOLD:
            self._told.add(text)
            log.warning("zenoh: %s", text)


@dataclass(frozen=True)
class Network:
    """A session that is open.

    Attributes:
        thread: has the session.
        graph: this server's topics and services.
        node: who stands in the graph for all others.
        session: id of the session.
        domain_id: ROS_DOMAIN_ID.
        namespace: of this server's names at the others.
        tokens: writes liveliness tokens.
        max_message_bytes: of a message, a request or a response, as from any other client [bytes].
        told: what has been warned of.
    """

    thread: SessionThread
    graph: Graph
    node: Node
    session: str
    domain_id: int
    namespace: Namespace
    tokens: Tokens
    max_message_bytes: int
    told: Told = field(default_factory=Told)

    def endpoint(self, outside: str, type_name: str, kind: SharedKind) -> Endpoint | None:
        """What the others know a topic or service by; None when its type has no hash.

        Args:
            outside: its name at the others.
            type_name: canonical name of its type.
            kind: which of the two.
        """
        try:
            return Endpoint(outside, type_name, _HASHES[kind](self.graph.interfaces.registry, type_name))
        except InterfaceError:
            self.told.warn(f"{outside} is not shared, the type {type_name} is unknown")
            return None

    def agrees(self, endpoint: Endpoint, kind: SharedKind) -> bool:
        """Whether this server has the same type as somebody else, to the field; else neither hears the other."""
        own = self.endpoint(endpoint.name, endpoint.type_name, kind)
        if own is not None and own != endpoint:
            self.told.warn(
                f"{endpoint.name} of another machine has another version of {endpoint.type_name}: "
                f"{endpoint.type_hash} there, {own.type_hash} here"
            )
        return own == endpoint

    def is_own_subscription(self, topic: str) -> bool:
        """Whether a part of the server itself listens to a topic, given as this server names it."""
        return any(not node.remote for node in self.graph.subscribers(topic))

    def is_own_publication(self, topic: str) -> bool:
        """Whether a part of the server itself publishes a topic, given as this server names it."""
        return any(not node.remote for node in self.graph.publishers(topic))
