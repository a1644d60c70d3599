"""Services of this server that others may call, as a ROS 2 machine offers them."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from protocol.codecs import cdr
from protocol.errors import MessageError
from server.access.authorization import Authorizer
from server.graph.services import Response
from server.zenoh import attachment
from server.zenoh.attachment import Attachment
from server.zenoh.keys import Endpoint, Kind
from server.zenoh.names import Patterns
from server.zenoh.network import MAX_SHARED, Network, undeclare

if TYPE_CHECKING:
    import zenoh

# Calls of all others together; each is a plan or a motion at worst, which takes its time.
MAX_CALLS_IN_FLIGHT = 64


class Asked(NamedTuple):
    """A call that has come: of which service, what is to be answered, the request, and who asks."""

    service: OfferedService
    query: zenoh.Query
    octets: bytes
    sender: Attachment | None


class OfferedService:
    """One service.

    Args:
        network: where it is offered.
        name: as this server calls it.
        endpoint: as the others call it.
        take: called with each call, in a thread of zenoh.
    """

    def __init__(self, network: Network, name: str, endpoint: Endpoint, take: Callable[[Asked], None]) -> None:
        self.name = name
        self.endpoint = endpoint
        self._network = network
        self._take = take
        self._key = endpoint.key(network.domain_id)
        self._token_key = network.tokens.entity(Kind.SERVICE, endpoint)
        self._queryable: zenoh.Queryable[None] | None = None
        self._token: zenoh.LivelinessToken | None = None

    def open(self) -> None:
        """Offer it."""
        self._network.thread.do(self._declare)

    def close(self) -> None:
        """Offer it no more."""
        self._network.thread.do(self._undeclare)

    def answer(self, asked: Asked, response: Response) -> None:
        """Send the response, or the sentence why there is none; in the thread of the session."""
        try:
            if not response.ok:
                asked.query.reply_err(str(response.values).encode())
                return
            registry = self._network.graph.interfaces.registry
            octets = cdr.serialize(registry, f"{self.endpoint.type_name}_Response", response.values)
            # rmw_zenoh finds the call that is answered by what was attached to its request.
            sender = asked.sender or Attachment(0, 0, bytes(attachment.GID_BYTES))
            attached = sender._replace(source_timestamp_ns=time.time_ns()).written()
            asked.query.reply(self._key, octets, attachment=attached)
        finally:
            # Tells the caller that there is no more to come.
            asked.query.drop()

    def _declare(self, session: zenoh.Session) -> None:
        import zenoh

        handler = zenoh.handlers.Callback(self._on_query, indirect=False)
        self._queryable = session.declare_queryable(self._key, handler, complete=True)
        self._token = session.liveliness().declare_token(self._token_key)

    def _undeclare(self, _session: zenoh.Session) -> None:
        undeclare(self._token, self._queryable)

    def _on_query(self, query: zenoh.Query) -> None:
        # Tools ask for all that fits a pattern to see what there is, which must not call anything.
        if query.payload is None or str(query.key_expr) != self._key:
            query.drop()
            return
        size_bytes = len(query.payload)
        # What is too large is not even copied; it cannot be read, which answers it.
        octets = bytes(query.payload) if size_bytes <= self._network.max_message_bytes else b""
        sender = None if query.attachment is None else attachment.read(bytes(query.attachment))
        self._take(Asked(self, query, octets, sender))


class OfferedServices:
    """All services of this server that others may call.

    Args:
        network: where they are offered.
        patterns: which ones.
        authorizer: what others may ask for.
        loop: the event loop.
    """

    def __init__(
        self, network: Network, patterns: Patterns, authorizer: Authorizer, loop: asyncio.AbstractEventLoop
    ) -> None:
        self._network = network
        self._patterns = patterns
        self._authorizer = authorizer
        self._loop = loop
        self._services: dict[str, OfferedService] = {}
        self._lock = threading.Lock()
        self._in_flight = 0

    def refresh(self) -> None:
        """Offer what is there now, and nothing else."""
        wanted = self._wanted()
        for name, service in list(self._services.items()):
            if wanted.get(name) != service.endpoint:
                self._services.pop(name).close()
        for name, endpoint in wanted.items():
            if name not in self._services and len(self._services) < MAX_SHARED:
                self._services[name] = OfferedService(self._network, name, endpoint, self._take)
                self._services[name].open()

    def _wanted(self) -> dict[str, Endpoint]:
        network, found = self._network, {}
        for name, type_name in network.graph.services.types().items():
            if self._patterns.fit(name) and network.graph.services.provider(name) is not network.node:
                endpoint = network.endpoint(network.namespace.outside(name), type_name, "srv")
                if endpoint is not None:
                    found[name] = endpoint
        return found

    def _take(self, asked: Asked) -> None:
        with self._lock:
            is_one_more = self._in_flight < MAX_CALLS_IN_FLIGHT
            self._in_flight += is_one_more
        if is_one_more:
            # The loop is closed when the server has ended, and the network has not.
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._call, asked)
        else:
            self._answer(asked, f"{MAX_CALLS_IN_FLIGHT} calls are on their way already")

    def _call(self, asked: Asked) -> None:
        network, name = self._network, asked.service.name

        def respond(response: Response) -> None:
            with self._lock:
                self._in_flight -= 1
            network.thread.do_call(lambda _session: asked.service.answer(asked, response))

        refusal = self._authorizer.calling(name)
        if refusal is not None:
            network.told.warn(refusal)
            respond(Response(ok=False, values=refusal))
            return
        try:
            type_name = f"{asked.service.endpoint.type_name}_Request"
            request = cdr.deserialize(network.graph.interfaces.registry, type_name, asked.octets)
        except MessageError as error:
            respond(Response(ok=False, values=f"Service {name}: {error}"))
        else:
            network.graph.services.call(network.node, name, request, respond)

    def _answer(self, asked: Asked, problem: str) -> None:
        response = Response(ok=False, values=f"Service {asked.service.name}: {problem}")
        self._network.thread.do_call(lambda _session: asked.service.answer(asked, response))
