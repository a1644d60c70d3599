"""Clients of the server: the ports that they connect to, and the tokens for them."""

from __future__ import annotations

from server.access.one_time_tokens import OneTimeTokenService
from server.features.context import ServerContext
from server.gateway.http import HttpHandler, Route
from server.gateway.listener import Listener
from server.lifecycle import Feature


class Clients(Feature):
    """The listener, and the service that issues tokens for it.

    Raises:
        ConfigurationError: the certificate cannot be used.
    """

    name = "clients"
    deadline_s = 0.6

    def __init__(self, context: ServerContext) -> None:
        self.routes: dict[str, Route] = {}
        access = context.access
        self.listener = Listener(
            context.graph,
            context.settings.server,
            HttpHandler(context.planning.robot, routes=self.routes),
            access,
            takes_goals_along=context.settings.goals.on_disconnect == "stop",
        )
        OneTimeTokenService(
            context.graph, access.one_time_tokens, access.tokens, lambda: self.listener.page_urls_elsewhere
        )

    async def start(self) -> None:
        await self.listener.bind()

    async def stop(self) -> None:
        await self.listener.close()
