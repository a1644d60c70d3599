"""Common ground of all that is shared: the network's session and names, filters, declarations, warnings."""

from __future__ import annotations

import asyncio
import fnmatch
import logging
import re
from collections.abc import Callable, Coroutine, Iterable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, Protocol, TypeAlias, TypeVar

import zenoh

from protocol import type_descriptions
from protocol.codecs import cdr
from protocol.errors import InterfaceError
from protocol.registry import Registry
from robot.logs import LogLimiter
from server.errors import GraphError
from server.graph.actions import ACTION_PARTS
from server.graph.message_types import BYTES_AT_ONCE, ReceivedMessage
from server.graph.permissions import Node
from server.graph.topics import Graph
from server.zenoh.rmw import Endpoint, LivelinessTokens, is_name
from server.zenoh.session import SessionThread

log = logging.getLogger("armbridge.zenoh")

SharedKind: TypeAlias = Literal["msg", "srv"]

Decoded = TypeVar("Decoded")
Wanted = TypeVar("Wanted")
Shared = TypeVar("Shared", bound="Closable")

_HASHES: Mapping[SharedKind, Callable[[Registry, str], str]] = {
    "msg": type_descriptions.message_hash,
    "srv": type_descriptions.service_hash,
}

# Warnings that are logged: a machine that invents names must not fill the log.
MAX_WARNINGS = 200

# Shared names of one kind, such as topics that come in: more than a large robot has.
MAX_SHARED = 1_000


class SharedNames:
    """Patterns of names, beside which ``always`` lets names pass, and ``never`` none. Parts of actions follow them."""

    def __init__(
        self,
        patterns: Iterable[str],
        always: Callable[[str], bool] = lambda _name: False,
        never: Callable[[str], bool] = lambda _name: False,
    ) -> None:
        self._expressions = [re.compile(fnmatch.translate(pattern)) for pattern in patterns]
        self._always = always
        self._never = never

    def matches(self, name: str) -> bool:
        """Return True for a name that matches, and that can be the name of something shared."""
        if not is_name(name) or self._never(name):
            return False
        base = name.partition(ACTION_PARTS)[0]
        return self._always(name) or any(each.match(base) for each in self._expressions)


class Declared(Protocol):
    """Entity that is declared on a zenoh session."""

    def undeclare(self) -> object:
        """Take the declaration back."""


class Declaration:
    """Entity that is declared, and its liveliness token; ``declare`` is None for a token alone."""

    def __init__(
        self, thread: SessionThread, token: str, declare: Callable[[zenoh.Session], Declared] | None = None
    ) -> None:
        self._thread = thread
        self._token = token
        self._declare = declare
        self._declared: list[Declared] = []
        thread.submit(self._declare_both)

    def _declare_both(self, session: zenoh.Session) -> None:
        if self._declare is not None:
            self._declared.append(self._declare(session))
        self._declared.append(session.liveliness().declare_token(self._token))

    def undeclare(self) -> None:
        """Take the declarations back, the last one first."""
        self._thread.submit(self._undeclare)

    def _undeclare(self, _session: zenoh.Session) -> None:
        while self._declared:
            self._declared.pop().undeclare()


@dataclass
class Network:
    """Network with an open session, and this server's graph, whose names have a prefix there.

    ``dropped`` counts messages of topics, in both directions, that found no place where they have to wait.
    """

    thread: SessionThread
    graph: Graph
    node: Node
    tokens: LivelinessTokens
    max_message_bytes: int
    threads: Executor
    loop: asyncio.AbstractEventLoop = field(default_factory=asyncio.get_running_loop)
    warnings: LogLimiter = field(default_factory=lambda: LogLimiter(max_keys=MAX_WARNINGS))
    tasks: set[asyncio.Task[None]] = field(default_factory=set)
    dropped: int = 0

    @property
    def domain_id(self) -> int:
        return self.tokens.domain_id

    def to_network(self, name: str) -> str:
        return f"{self.tokens.namespace}{name}"

    def to_local(self, name: str) -> str:
        """Return this server's name of a name on the network; names of other namespaces stay the same."""
        return name[len(self.tokens.namespace) :] if self.is_local(name) else name

    def is_local(self, name: str) -> bool:
        """Return True for a name on the network that is in this server's namespace."""
        return name.startswith(f"{self.tokens.namespace}/")

    @property
    def registry(self) -> Registry:
        return self.graph.message_types.registry

    def warn(self, text: str) -> None:
        """Log a warning, unless it has been logged before."""
        self.warnings.write(log, logging.WARNING, f"zenoh: {text}", text)

    def declare(self, token: str, declare: Callable[[zenoh.Session], Declared] | None = None) -> Declaration:
        return Declaration(self.thread, token, declare)

    def endpoint(self, network_name: str, type_name: str, kind: SharedKind) -> Endpoint | None:
        """Return the endpoint of a topic or service; None if its type is unknown."""
        try:
            return Endpoint(network_name, type_name, _HASHES[kind](self.registry, type_name))
        except InterfaceError:
            self.warn(f"{network_name} is not shared, the type {type_name} is unknown")
            return None

    def agrees(self, endpoint: Endpoint, kind: SharedKind) -> bool:
        """Return True if another machine's type is the same to the field; otherwise neither hears the other."""
        own = self.endpoint(endpoint.name, endpoint.type_name, kind)
        if own is not None and own != endpoint:
            self.warn(
                f"{endpoint.name} of another machine has another version of {endpoint.type_name}: "
                f"{endpoint.type_hash} there, {own.type_hash} here"
            )
        return own == endpoint

    def is_own_subscription(self, topic: str) -> bool:
        return any(not node.remote for node in self.graph.subscribers(topic))

    def is_own_publication(self, topic: str) -> bool:
        return any(not node.remote for node in self.graph.publishers(topic))

    def start(self, work: Coroutine[Any, Any, None]) -> None:
        """Do some work beside everything else, at most until the network is left."""
        task = self.loop.create_task(work)
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    def read(self, type_name: str, octets: bytes) -> ReceivedMessage:
        """Decode a message in this thread, or raise MessageError."""
        return self._received(type_name, cdr.deserialize(self.registry, type_name, octets), octets)

    async def decode(self, type_name: str, octets: bytes) -> ReceivedMessage:
        """Decode a message, a large one in a thread, or raise MessageError."""
        return await self._decode(octets, lambda: self.read(type_name, octets))

    async def decode_member(self, type_name: str, member: str, octets: bytes) -> dict[str, Any]:
        """Decode a message as :meth:`decode`, with a `ReceivedMessage` in the field ``member``."""
        (member_type,) = (field.base for field in self.registry.message(type_name).fields if field.name == member)

        def read() -> dict[str, Any]:
            message = cdr.deserialize(self.registry, type_name, octets)
            return {**message, member: self._received(member_type, message[member], octets)}

        return await self._decode(octets, read)

    async def _decode(self, octets: bytes, read: Callable[[], Decoded]) -> Decoded:
        return read() if len(octets) <= BYTES_AT_ONCE else await self.loop.run_in_executor(self.threads, read)

    def _received(self, type_name: str, message: dict[str, Any], octets: bytes) -> ReceivedMessage:
        received = ReceivedMessage(message, len(octets))
        received.complete(self.graph.message_types, type_name)
        return received


class Closable(Protocol):
    """Something that is shared until it is closed."""

    def close(self) -> None:
        """Share it no longer."""


class SharedEndpoints(Generic[Wanted, Shared]):
    """Topics or services that are shared in one direction, by name, each with the request that it was made for."""

    def __init__(self, network: Network, make: Callable[[str, Wanted], Shared]) -> None:
        self._network = network
        self._make = make
        self._made: dict[str, tuple[Wanted, Shared]] = {}

    def follow(self, wanted: Mapping[str, Wanted]) -> None:
        """Share the wanted names and no others; a name whose request has changed is closed and shared again."""
        for name, (former, shared) in list(self._made.items()):
            if wanted.get(name) != former:
                del self._made[name]
                shared.close()
        for name, each in wanted.items():
            if name not in self._made and len(self._made) < MAX_SHARED:
                try:
                    self._made[name] = each, self._make(name, each)
                except GraphError as error:
                    self._network.warn(f"{name} is not shared: {error}")

    def is_shared(self, name: str, shared: Shared) -> bool:
        return name in self._made and self._made[name][1] is shared
