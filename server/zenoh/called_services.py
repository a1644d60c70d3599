"""Services of others that clients of this server may call."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from protocol.codecs import cdr
from protocol.errors import MessageError
from server.errors import GraphError
from server.graph.services import LOCAL_TIMEOUT_S, Call
from server.zenoh.attachment import Attachment, gid_of
from server.zenoh.keys import Endpoint, Entity, Kind
from server.zenoh.names import Patterns
from server.zenoh.network import MAX_SHARED, Network, undeclare

if TYPE_CHECKING:
    import zenoh

# Of one service; the others wait at its machine.
MAX_CALLS_IN_FLIGHT = 64


class CalledService:
    """One service.

    Args:
        network: where it is offered.
        name: as this server calls it.
        endpoint: as the others call it.
        loop: the event loop.
    """

    def __init__(self, network: Network, name: str, endpoint: Endpoint, loop: asyncio.AbstractEventLoop) -> None:
        self.endpoint = endpoint
        self._network = network
        self._name = name
        self._loop = loop
        self._token_key = network.tokens.entity(Kind.CLIENT, endpoint)
        self._gid = gid_of(self._token_key)
        self._sent = 0
        self._in_flight = 0
        self._token: zenoh.LivelinessToken | None = None

    def open(self) -> None:
        """Let clients call it.

        Raises:
            GraphError: another service has its name.
        """
        services, node = self._network.graph.services, self._network.node
        services.offer_calls(node, self._name, self.endpoint.type_name, self._start, LOCAL_TIMEOUT_S)
        self._network.thread.do(self._declare)

    def close(self) -> None:
        """Let nobody call it any more; calls on their way fail."""
        self._network.graph.services.withdraw(self._network.node, self._name)
        self._network.thread.do(self._undeclare)

    def _start(self, call: Call) -> None:
        if self._in_flight >= MAX_CALLS_IN_FLIGHT:
            call.fail(f"Service {self._name}: {MAX_CALLS_IN_FLIGHT} calls are on their way already")
            return
        self._in_flight += 1
        call.when_ended(self._count_end)
        registry = self._network.graph.interfaces.registry
        octets = cdr.serialize(registry, f"{self.endpoint.type_name}_Request", call.request)
        self._sent += 1
        attached = Attachment(self._sent, time.time_ns(), self._gid).written()
        if not self._network.thread.do_call(lambda session: self._get(session, call, octets, attached)):
            call.fail(f"Service {self._name}: the network stands still")

    def _count_end(self, _response: object) -> None:
        self._in_flight -= 1

    def _get(self, session: zenoh.Session, call: Call, octets: bytes, attached: bytes) -> None:
        import zenoh

        most_bytes = self._network.max_message_bytes

        def take(reply: zenoh.Reply) -> None:
            if reply.ok is not None and len(reply.ok.payload) > most_bytes:
                self._later(call.fail, f"Service {self._name} gave a response of more than {most_bytes} bytes")
            elif reply.ok is not None:
                self._later(self._finish, call, bytes(reply.ok.payload))
            elif reply.err is not None:
                self._later(call.fail, bytes(reply.err.payload).decode(errors="replace"))

        def end() -> None:
            self._later(call.fail, f"Service {self._name} has not answered")

        session.get(
            self.endpoint.key(self._network.domain_id),
            zenoh.handlers.Callback(take, end, indirect=False),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=LOCAL_TIMEOUT_S,
            congestion_control=zenoh.CongestionControl.DROP,
            payload=octets,
            attachment=attached,
        )

    def _later(self, function: Callable[..., object], *arguments: object) -> None:
        # The loop is closed when the server has ended, and the network has not.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(function, *arguments)

    def _finish(self, call: Call, octets: bytes) -> None:
        registry, type_name = self._network.graph.interfaces.registry, f"{self.endpoint.type_name}_Response"
        try:
            call.succeed(cdr.deserialize(registry, type_name, octets))
        except MessageError as error:
            call.fail(f"Service {self._name} gave a response that does not fit {self.endpoint.type_name}: {error}")

    def _declare(self, session: zenoh.Session) -> None:
        self._token = session.liveliness().declare_token(self._token_key)

    def _undeclare(self, _session: zenoh.Session) -> None:
        undeclare(self._token)


class CalledServices:
    """All services of others that clients may call.

    Args:
        network: where they are offered.
        patterns: which ones, as this server calls them.
        loop: the event loop.
    """

    def __init__(self, network: Network, patterns: Patterns, loop: asyncio.AbstractEventLoop) -> None:
        self._network = network
        self._patterns = patterns
        self._loop = loop
        self._services: dict[str, CalledService] = {}
        self._entities: tuple[Entity, ...] = ()
        self._announced: dict[str, Endpoint] = {}

    def refresh(self, entities: tuple[Entity, ...]) -> None:
        """Let clients call what is there now, and nothing else.

        Args:
            entities: all others; the same object for as long as nothing changes.
        """
        if entities is not self._entities:
            self._entities, self._announced = entities, self._endpoints(entities)
        wanted = {name: endpoint for name, endpoint in self._announced.items() if not self._is_taken(name)}
        for name, service in list(self._services.items()):
            if wanted.get(name) != service.endpoint:
                self._services.pop(name).close()
        for name, endpoint in wanted.items():
            if name not in self._services and len(self._services) < MAX_SHARED:
                self._open(name, CalledService(self._network, name, endpoint, self._loop))

    def _open(self, name: str, service: CalledService) -> None:
        try:
            service.open()
        except GraphError as error:
            self._network.told.warn(f"{service.endpoint.name} cannot be called: {error}")
        else:
            self._services[name] = service

    def _endpoints(self, entities: Iterable[Entity]) -> dict[str, Endpoint]:
        """What others offer and clients may call, by the name that it has here."""
        network, found = self._network, dict[str, Endpoint]()
        for entity in entities:
            endpoint, name = entity.endpoint, network.namespace.inside(entity.endpoint.name)
            if entity.kind is Kind.SERVICE and self._patterns.fit(name) and network.agrees(endpoint, "srv"):
                found.setdefault(name, endpoint)
        return found

    def _is_taken(self, name: str) -> bool:
        """Whether somebody here offers a service of this name; a client that has taken it keeps it."""
        is_taken = self._network.graph.services.provider(name) not in (None, self._network.node)
        if is_taken:
            self._network.told.warn(
                f"{name} of another machine cannot be called, a service of that name is offered here"
            )
        return is_taken
