"""Clients of the server: the ports that they connect to, and the tokens for them."""

from __future__ import annotations

from server.access.one_time_tokens import OneTimeTokenService
from server.features.context import ServerContext
from server.features.interface import PATH, InterfaceDocument
from server.gateway import http_goals
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
        self.routes: dict[str, Route] = {PATH: InterfaceDocument(context).answer}
        access, stops = context.access, context.settings.goals.on_disconnect == "stop"
        names = [each.name for each in context.arms if each.name]
        goals = http_goals.HttpGoals(context.graph, access, names, takes_goals_along=stops)
        self.listener = Listener(
            context.graph,
            context.settings.server,
            HttpHandler(context.planning.robot, routes=self.routes, post_routes={http_goals.PATH: goals.answer}),
            access,
            takes_goals_along=stops,
        )
        OneTimeTokenService(
            context.graph, access.one_time_tokens, access.tokens, lambda: self.listener.page_urls_elsewhere
        )

    async def start(self) -> None:
        await self.listener.bind()

    async def stop(self) -> None:
        await self.listener.close()
