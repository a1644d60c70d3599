"""Bridge between the graph and a zenoh network: discovers other machines, and shares topics and services with them."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import zenoh

from server.access.authorization import Access, Authorizer, rule_of_service, rule_of_topic
from server.graph.actions import ACTION_PARTS
from server.graph.permissions import Identity, Node, Role
from server.graph.topics import Graph
from server.zenoh.network import Network, SharedNames
from server.zenoh.rmw import ADMIN_SPACE, Entity, EntityKind, LivelinessTokens
from server.zenoh.services import CalledServices, OfferedServices
from server.zenoh.session import SessionThread
from server.zenoh.settings import ZenohSettings, session_config
from server.zenoh.topics import IncomingTopics, OutgoingTopics

log = logging.getLogger("armbridge.zenoh")

# Delay after which a change in the graph, or of another machine, is known on the other side.
REFRESH_PERIOD_S = 0.5

# Names and types of topics that nobody uses any more become free with time alone.
FULL_REFRESH_PERIOD_S = 5.0

# Entities of other machines, far more than a few robots have: tokens that somebody invents must not grow the server.
MAX_ENTITIES = 1_000

# For large messages; with more, the event loop waits for the interpreter's lock behind each.
DECODING_THREADS = 2

# Ends of the topics that stop an arm, several, or one of several, which has them below its name; they always go out.
STOPS = ("/stop", "/emergency_stop")


class Bridge:
    """Member of a zenoh network, or ConfigurationError where zenoh rejects the configuration."""

    def __init__(self, graph: Graph, settings: ZenohSettings, access: Access, max_message_bytes: int) -> None:
        config = session_config(settings)
        self._graph = graph
        self._settings = settings
        self._max_message_bytes = max_message_bytes
        self._node = Node("zenoh", remote=True, identity=Identity("", Role[settings.role.upper()]))
        self._authorizer = Authorizer(self._node, access, graph)
        self._thread = SessionThread(lambda: zenoh.open(config))
        self._threads = ThreadPoolExecutor(DECODING_THREADS, thread_name_prefix="zenoh decoding")
        # None as long as there is no session.
        self._sharing: Sharing | None = None

    @property
    def dropped(self) -> int:
        return 0 if self._sharing is None else self._sharing.dropped

    async def run(self) -> None:
        """Join the network as soon as it can be reached, and share until cancelled; then leave it."""
        self._thread.start()
        try:
            session = await asyncio.wrap_future(self._thread.opened)
            log.info(
                "zenoh: in the network as %s %s, domain %d", self._settings.mode, session, self._settings.domain_id
            )
            tokens = LivelinessTokens(self._settings.domain_id, session, self._settings.namespace)
            network = Network(self._thread, self._graph, self._node, tokens, self._max_message_bytes, self._threads)
            self._sharing = Sharing(network, self._settings, self._authorizer)
            await self._sharing.run()
        finally:
            self._threads.shutdown(wait=False, cancel_futures=True)
            if self._sharing is not None:
                self._sharing.end_tasks()
            if not await asyncio.to_thread(self._thread.close):
                log.error("zenoh: the network was not left in time")
            self._authorizer.leave()
            self._graph.remove(self._node)


class Sharing:
    """Topics and services that are shared, in both directions."""

    def __init__(self, network: Network, settings: ZenohSettings, authorizer: Authorizer) -> None:
        self._network = network
        graph = network.graph
        # Stops go across in both directions, whatever is listed.
        self._offer = SharedNames(settings.offer, lambda name: rule_of_service(name, graph).stops)
        self._call = SharedNames(settings.call)
        self._subscribe = SharedNames(
            settings.subscribe,
            lambda name: rule_of_topic(name, graph).stops,
            # A called action has these topics of its own.
            never=lambda name: ACTION_PARTS in name and self._call.matches(name),
        )
        self._publish = SharedNames(
            settings.publish, lambda name: name.endswith(STOPS) or (ACTION_PARTS in name and self._offer.matches(name))
        )
        self._outgoing = OutgoingTopics(network, self._publish)
        self._incoming = IncomingTopics(network, self._subscribe, authorizer)
        self._offered = OfferedServices(network, self._offer, authorizer)
        self._called = CalledServices(network, self._call)
        self._seen: tuple[int, int, int] | None = None
        self._refreshed_s = graph.clock()
        self._discovery = Discovery(network.domain_id, network.tokens.session, self._is_relevant)
        network.thread.submit(self._discovery.subscribe)
        self._node = network.declare(network.tokens.node())

    @property
    def dropped(self) -> int:
        return self._network.dropped + self._incoming.received.dropped

    def end_tasks(self) -> None:
        """End the work for other machines that is in progress."""
        for task in self._network.tasks:
            task.cancel()

    async def run(self) -> None:
        """Refresh after every change, and in any case from time to time, until cancelled."""
        while True:
            self.follow()
            await asyncio.sleep(REFRESH_PERIOD_S)

    def follow(self) -> None:
        """Refresh if anything has changed, or the last refresh is long ago."""
        graph, now_s = self._network.graph, self._network.graph.clock()
        # Noted before the refresh: what that changes is looked at once more.
        seen = graph.revision, graph.services.names.revision, self._discovery.revision
        if seen == self._seen and now_s < self._refreshed_s + FULL_REFRESH_PERIOD_S:
            return
        self._seen, self._refreshed_s = seen, now_s
        try:
            self.refresh()
        except Exception:  # an error with one name must not end the rest
            log.exception("zenoh: a refresh failed")

    def refresh(self) -> None:
        entities = self._discovery.entities()
        self._incoming.refresh(entities)
        self._called.refresh(entities)
        self._outgoing.refresh(frozenset(each.endpoint.name for each in entities if self._is_foreign(each)))
        self._offered.refresh(entities)

    def _is_relevant(self, entity: Entity) -> bool:
        name = self._network.to_local(entity.endpoint.name)
        if entity.kind is EntityKind.SERVICE:
            return self._call.matches(name)
        if entity.kind is EntityKind.CLIENT:
            return self._offer.matches(name)
        if entity.kind is EntityKind.PUBLISHER and self._subscribe.matches(name):
            return True
        return self._is_foreign(entity) and self._publish.matches(name)

    def _is_foreign(self, entity: Entity) -> bool:
        is_topic = entity.kind in (EntityKind.PUBLISHER, EntityKind.SUBSCRIPTION)
        return is_topic and not self._network.is_local(entity.endpoint.name)


class Discovery:
    """Entities of other machines, by the liveliness tokens of rmw_zenoh, which vanish together with their machine.

    Updated by zenoh's threads, which call ``is_relevant``, and read by the event loop.
    """

    def __init__(self, domain_id: int, session: str, is_relevant: Callable[[Entity], bool]) -> None:
        self._domain_id = domain_id
        self._session = session
        self._is_relevant = is_relevant
        self._lock = threading.Lock()
        self._by_token: dict[str, Entity] = {}
        self.revision = 0  # grows with each change

    def subscribe(self, session: zenoh.Session) -> None:
        """Subscribe to tokens, those that exist already first; in the session's thread."""
        handler = zenoh.handlers.Callback(self._on_token, indirect=False)
        session.liveliness().declare_subscriber(f"{ADMIN_SPACE}/{self._domain_id}/**", handler, history=True)

    def entities(self) -> tuple[Entity, ...]:
        """Return the entities that exist now, each once."""
        with self._lock:
            return tuple(dict.fromkeys(self._by_token.values()))

    def update(self, token: str, *, alive: bool) -> None:
        entity = Entity.parse(token) if alive else None
        is_kept = entity is not None and entity.session != self._session and self._is_relevant(entity)
        with self._lock:
            if entity is not None and is_kept and len(self._by_token) < MAX_ENTITIES:
                self._by_token[token] = entity
                self.revision += 1
            elif not alive and self._by_token.pop(token, None) is not None:
                self.revision += 1

    def _on_token(self, sample: zenoh.Sample) -> None:
        self.update(str(sample.key_expr), alive=sample.kind == zenoh.SampleKind.PUT)
