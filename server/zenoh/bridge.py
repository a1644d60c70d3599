"""The bridge: this server's part in a zenoh network, from its settings to the graph."""

from __future__ import annotations

import asyncio
import contextlib
import logging

from server.access.authorization import Access
from server.access.permissions import Identity, Role
from server.graph.node import Node
from server.graph.topics import Graph
from server.zenoh.keys import Tokens
from server.zenoh.names import Namespace
from server.zenoh.network import Network
from server.zenoh.session_config import session_config
from server.zenoh.session_thread import SessionThread
from server.zenoh.settings import ZenohSettings
from server.zenoh.sharing import Sharing

log = logging.getLogger("armbridge.zenoh")


class Bridge:
    """Joins a zenoh network, and shares what the settings say.

    Args:
        graph: topics and services.
        settings: the section ``zenoh``; its mode is not off.
        access: what those who send something may do.
        max_message_bytes: of what comes in [bytes].

    Raises:
        ConfigurationError: zenoh is not installed, or cannot be configured so.
    """

    def __init__(self, graph: Graph, settings: ZenohSettings, access: Access, max_message_bytes: int) -> None:
        # Imported when it is needed: most servers share nothing, and few have it installed.
        config = session_config(settings)
        import zenoh

        self._graph = graph
        self._settings = settings
        self._max_message_bytes = max_message_bytes
        self._node = Node("zenoh", remote=True, identity=Identity("", Role[settings.role.upper()]))
        self._authorizer = access.authorizer(self._node)
        self._thread = SessionThread(lambda: zenoh.open(config), self._opened)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._sharing: Sharing | None = None
        self._running: asyncio.Task[None] | None = None

    @property
    def dropped(self) -> int:
        """How many messages were lost because the network, or this server, was too slow."""
        return 0 if self._sharing is None else self._sharing.dropped

    def open(self) -> None:
        """Begin to join; what is shared follows when there is a network."""
        self._loop = asyncio.get_running_loop()
        self._thread.start()

    async def close(self) -> None:
        """Leave the network; nothing happens when it was not to be joined yet."""
        if self._loop is None:
            return
        if self._running is not None:
            self._running.cancel()
        if not await asyncio.to_thread(self._thread.close):
            log.error("zenoh: the network was not left in time")
        self._authorizer.leave()
        self._graph.remove(self._node)

    def _opened(self, session: str) -> None:
        # The loop is closed when the server has ended meanwhile.
        with contextlib.suppress(RuntimeError):
            if self._loop is not None:
                self._loop.call_soon_threadsafe(self._share, session)

    def _share(self, session: str) -> None:
        settings = self._settings
        namespace, tokens = Namespace(settings.namespace), Tokens(settings.domain_id, session, settings.namespace)
        network = Network(
            self._thread,
            self._graph,
            self._node,
            session,
            settings.domain_id,
            namespace,
            tokens,
            self._max_message_bytes,
        )
        self._sharing = Sharing(network, settings, self._authorizer)
        self._running = asyncio.ensure_future(self._sharing.run())
        log.info("zenoh: in the network as %s %s, domain %d", settings.mode, session, settings.domain_id)
