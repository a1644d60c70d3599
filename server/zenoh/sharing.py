"""What is shared while there is a network: all four directions, refreshed together."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING

from server.access.authorization import Authorizer, rule_of_service, rule_of_topic
from server.zenoh.called_services import CalledServices
from server.zenoh.discovery import Discovery
from server.zenoh.incoming import IncomingTopics
from server.zenoh.keys import Entity, Kind
from server.zenoh.names import Patterns
from server.zenoh.network import Network
from server.zenoh.offered_services import OfferedServices
from server.zenoh.outgoing import OutgoingTopics
from server.zenoh.settings import ZenohSettings

if TYPE_CHECKING:
    import zenoh

log = logging.getLogger("armbridge.zenoh")

# How long what is new in the graph, or at the others, may stay unknown on the other side.
REFRESH_PERIOD_S = 0.5


class Sharing:
    """Topics and services on their ways.

    Args:
        network: the session.
        settings: what is shared.
        authorizer: what others may do here.
    """

    def __init__(self, network: Network, settings: ZenohSettings, authorizer: Authorizer) -> None:
        loop = asyncio.get_running_loop()
        self._network = network
        # Whoever may command the arm must be able to stop it.
        self._subscribe = Patterns(settings.subscribe, lambda name: rule_of_topic(name).stops)
        offer = Patterns(settings.offer, lambda name: rule_of_service(name).stops)
        self._publish, self._call = Patterns(settings.publish), Patterns(settings.call)
        self._discovery = Discovery(network.domain_id, network.session, self._concerns)
        self._outgoing = OutgoingTopics(network, self._publish)
        self._incoming = IncomingTopics(network, self._subscribe, authorizer, loop)
        self._offered = OfferedServices(network, offer, authorizer, loop)
        self._called = CalledServices(network, self._call, loop)
        self._entities: tuple[Entity, ...] = ()
        self._foreign: frozenset[str] = frozenset()
        self._node_token: zenoh.LivelinessToken | None = None

    @property
    def dropped(self) -> int:
        """How many messages were lost because the network, or this server, was too slow."""
        return self._outgoing.dropped + self._incoming.dropped

    async def run(self) -> None:
        """Share, until cancelled."""
        self._network.thread.do(self._discovery.open)
        self._network.thread.do(self._declare_node)
        while True:
            try:
                self.refresh()
            except Exception:  # what goes wrong with one name must not end the rest
                log.exception("zenoh: a refresh failed")
            await asyncio.sleep(REFRESH_PERIOD_S)

    def refresh(self) -> None:
        """Follow what has changed in the graph and at the others."""
        entities = self._discovery.entities()
        self._incoming.refresh(entities)
        self._called.refresh(entities)
        if entities is not self._entities:
            self._entities = entities
            self._foreign = frozenset(each.endpoint.name for each in entities if self._is_foreign(each))
        self._outgoing.refresh(self._foreign)
        self._offered.refresh()

    def _concerns(self, entity: Entity) -> bool:
        """Whether somebody at the others can matter; called in a thread of zenoh."""
        name = self._network.namespace.inside(entity.endpoint.name)
        if entity.kind is Kind.SERVICE:
            return self._call.fit(name)
        if entity.kind is Kind.PUBLISHER and self._subscribe.fit(name):
            return True
        return self._is_foreign(entity) and self._publish.fit(name)

    def _is_foreign(self, entity: Entity) -> bool:
        is_topic = entity.kind in (Kind.PUBLISHER, Kind.SUBSCRIPTION)
        return is_topic and not self._network.namespace.has(entity.endpoint.name)

    def _declare_node(self, session: zenoh.Session) -> None:
        self._node_token = session.liveliness().declare_token(self._network.tokens.node())
