"""Services shared with other machines: offered by this server, and called by its clients."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from protocol.codecs import cdr
from protocol.errors import MessageError
from server.access.authorization import Authorizer
from server.errors import GraphError
from server.graph.message_types import ReceivedMessage
from server.graph.services import LOCAL_TIMEOUT_S, Call, Response
from server.zenoh.network import MAX_SHARED, Declared, Network, SharedNames
from server.zenoh.rmw import GID_BYTES, Attachment, Endpoint, Entity, EntityKind, gid_of
from server.zenoh.session import call_in_loop

if TYPE_CHECKING:
    import zenoh

# Calls of all other machines in progress; at worst each is a plan or a motion, which takes its time.
MAX_INCOMING_CALLS = 64

# Calls of one service of another machine in progress; the others would wait there.
MAX_OUTGOING_CALLS = 64


class IncomingCall(NamedTuple):
    """Call of a service of this server."""

    service: OfferedService
    query: zenoh.Query
    octets: bytes
    sender: Attachment | None


class OfferedService:
    """Service of this server that other machines may call."""

    def __init__(
        self, network: Network, name: str, endpoint: Endpoint, receive: Callable[[IncomingCall], None]
    ) -> None:
        self.name = name
        self.endpoint = endpoint
        self._network = network
        self._receive = receive
        self._key = endpoint.key(network.domain_id)
        self._token = network.tokens.entity(EntityKind.SERVICE, endpoint)
        self._declaration = network.declare(self._declare)

    def close(self) -> None:
        """Stop offering the service."""
        self._declaration.undeclare()

    def reply(self, call: IncomingCall, response: Response) -> None:
        """Send the response, or the sentence of a failed call; in the session's thread."""
        try:
            if not response.ok:
                call.query.reply_err(str(response.values).encode())
                return
            octets = cdr.serialize(self._network.registry, f"{self.endpoint.type_name}_Response", response.values)
            # rmw_zenoh matches response and call by the attachment of the request.
            sender = call.sender or Attachment(0, 0, bytes(GID_BYTES))
            attachment = sender._replace(source_timestamp_ns=time.time_ns()).encode()
            call.query.reply(self._key, octets, attachment=attachment)
        finally:
            # Ends the query: no further reply follows.
            call.query.drop()

    def _declare(self, session: zenoh.Session) -> Iterator[Declared]:
        import zenoh

        handler = zenoh.handlers.Callback(self._on_query, indirect=False)
        yield session.declare_queryable(self._key, handler, complete=True)
        yield session.liveliness().declare_token(self._token)

    def _on_query(self, query: zenoh.Query) -> None:
        # Tools query all keys that match a pattern to list them, which must not call anything.
        if query.payload is None or str(query.key_expr) != self._key:
            query.drop()
            return
        size_bytes = len(query.payload)
        # A request that is too large is not even copied; empty, it is answered as unreadable.
        octets = bytes(query.payload) if size_bytes <= self._network.max_message_bytes else b""
        sender = None if query.attachment is None else Attachment.decode(bytes(query.attachment))
        self._receive(IncomingCall(self, query, octets, sender))


class OfferedServices:
    """All services of this server that other machines may call."""

    def __init__(self, network: Network, names: SharedNames, authorizer: Authorizer) -> None:
        self._network = network
        self._names = names
        self._authorizer = authorizer
        self._services: dict[str, OfferedService] = {}
        self._lock = threading.Lock()
        self._in_progress = 0

    def refresh(self) -> None:
        """Offer the services that exist now, and no others."""
        wanted = self._wanted()
        for name, service in list(self._services.items()):
            if wanted.get(name) != service.endpoint:
                self._services.pop(name).close()
        for name, endpoint in wanted.items():
            if name not in self._services and len(self._services) < MAX_SHARED:
                self._services[name] = OfferedService(self._network, name, endpoint, self._receive)

    def _wanted(self) -> dict[str, Endpoint]:
        network, found = self._network, {}
        for name, type_name in network.graph.services.types().items():
            if self._names.matches(name) and network.graph.services.provider(name) is not network.node:
                endpoint = network.endpoint(network.namespace.to_network(name), type_name, "srv")
                if endpoint is not None:
                    found[name] = endpoint
        return found

    def _receive(self, call: IncomingCall) -> None:
        with self._lock:
            is_accepted = self._in_progress < MAX_INCOMING_CALLS
            self._in_progress += is_accepted
        if is_accepted:
            call_in_loop(self._network.loop, self._call, call)
        else:
            self._fail(call, f"{MAX_INCOMING_CALLS} calls are on their way already")

    def _call(self, call: IncomingCall) -> None:
        network, name = self._network, call.service.name

        def respond(response: Response) -> None:
            with self._lock:
                self._in_progress -= 1
            network.thread.submit_call(lambda _session: call.service.reply(call, response))

        refusal = self._authorizer.calling(name, None)
        if refusal is not None:
            network.warn(refusal)
            respond(Response(ok=False, values=refusal))
            return

        def take(request: ReceivedMessage | MessageError) -> None:
            if isinstance(request, MessageError):
                respond(Response(ok=False, values=f"Service {name}: {request}"))
            else:
                network.graph.services.call(network.node, name, request, respond)

        network.decode(f"{call.service.endpoint.type_name}_Request", call.octets, take)

    def _fail(self, call: IncomingCall, reason: str) -> None:
        response = Response(ok=False, values=f"Service {call.service.name}: {reason}")
        self._network.thread.submit_call(lambda _session: call.service.reply(call, response))


class CalledService:
    """Service of another machine that clients of this server may call.

    Raises:
        GraphError: another service has its name.
    """

    def __init__(self, network: Network, name: str, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._network = network
        self._name = name
        self._token = network.tokens.entity(EntityKind.CLIENT, endpoint)
        self._gid = gid_of(self._token)
        self._sent = 0
        self._in_progress = 0
        services = network.graph.services
        services.offer_calls(network.node, name, endpoint.type_name, self._start, limits=None)
        self._declaration = network.declare(self._declare)

    def close(self) -> None:
        """Withdraw the service; calls in progress fail."""
        self._network.graph.services.withdraw(self._network.node, self._name)
        self._declaration.undeclare()

    def _declare(self, session: zenoh.Session) -> Iterator[Declared]:
        yield session.liveliness().declare_token(self._token)

    def _start(self, call: Call) -> None:
        if self._in_progress >= MAX_OUTGOING_CALLS:
            call.fail(f"Service {self._name}: {MAX_OUTGOING_CALLS} calls are on their way already")
            return
        self._in_progress += 1
        call.when_ended(self._on_end)
        self._sent += 1
        attachment = Attachment(self._sent, time.time_ns(), self._gid).encode()
        if not self._network.thread.submit_call(lambda session: self._get(session, call, attachment)):
            call.fail(f"Service {self._name}: the network stands still")

    def _on_end(self, _response: object) -> None:
        self._in_progress -= 1

    def _get(self, session: zenoh.Session, call: Call, attachment: bytes) -> None:
        import zenoh

        loop, limit = self._network.loop, self._network.max_message_bytes
        octets = cdr.serialize(self._network.registry, f"{self.endpoint.type_name}_Request", call.request)

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None and len(reply.ok.payload) > limit:
                call_in_loop(loop, call.fail, f"Service {self._name} gave a response of more than {limit} bytes")
            elif reply.ok is not None:
                call_in_loop(loop, self._respond, call, bytes(reply.ok.payload))
            elif reply.err is not None:
                call_in_loop(loop, call.fail, bytes(reply.err.payload).decode(errors="replace"))

        def on_end() -> None:
            call_in_loop(loop, call.fail, f"Service {self._name} has not answered")

        session.get(
            self.endpoint.key(self._network.domain_id),
            zenoh.handlers.Callback(on_reply, on_end, indirect=False),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=LOCAL_TIMEOUT_S,
            congestion_control=zenoh.CongestionControl.DROP,
            payload=octets,
            attachment=attachment,
        )

    def _respond(self, call: Call, octets: bytes) -> None:
        def take(response: ReceivedMessage | MessageError) -> None:
            try:
                if isinstance(response, MessageError):
                    raise response
                call.succeed(response)
            except MessageError as error:
                call.fail(f"Service {self._name} gave a response that does not fit {self.endpoint.type_name}: {error}")

        self._network.decode(f"{self.endpoint.type_name}_Response", octets, take)


class CalledServices:
    """All services of other machines that clients of this server may call."""

    def __init__(self, network: Network, names: SharedNames) -> None:
        self._network = network
        self._names = names
        self._services: dict[str, CalledService] = {}
        self._entities: tuple[Entity, ...] = ()
        self._announced: dict[str, Endpoint] = {}

    def refresh(self, entities: tuple[Entity, ...]) -> None:
        """Let clients call the services that exist now, and no others."""
        if entities is not self._entities:
            self._entities, self._announced = entities, self._endpoints(entities)
        wanted = {name: endpoint for name, endpoint in self._announced.items() if not self._is_taken(name)}
        for name, service in list(self._services.items()):
            if wanted.get(name) != service.endpoint:
                self._services.pop(name).close()
        for name, endpoint in wanted.items():
            if name not in self._services and len(self._services) < MAX_SHARED:
                self._offer(name, endpoint)

    def _offer(self, name: str, endpoint: Endpoint) -> None:
        try:
            self._services[name] = CalledService(self._network, name, endpoint)
        except GraphError as error:
            self._network.warn(f"{endpoint.name} cannot be called: {error}")

    def _endpoints(self, entities: Iterable[Entity]) -> dict[str, Endpoint]:
        network, found = self._network, dict[str, Endpoint]()
        for entity in entities:
            endpoint, name = entity.endpoint, network.namespace.to_local(entity.endpoint.name)
            if entity.kind is EntityKind.SERVICE and self._names.matches(name) and network.agrees(endpoint, "srv"):
                found.setdefault(name, endpoint)
        return found

    def _is_taken(self, name: str) -> bool:
        """Return True if this server or a client offers a service of this name, and keeps it."""
        is_taken = self._network.graph.services.provider(name) not in (None, self._network.node)
        if is_taken:
            self._network.warn(f"{name} of another machine cannot be called, a service of that name is offered here")
        return is_taken
