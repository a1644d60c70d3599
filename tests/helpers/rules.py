"""Rules of the names that a server offers and listens to, for tests of a graph without the server's parts."""

import asyncio
import functools
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

from server.app import App
from server.config import Settings
from server.graph.permissions import Rule
from server.graph.topics import Graph


class ServerRules(NamedTuple):
    """Rules by name."""

    services: dict[str, Rule]
    topics: dict[str, Rule]
    actions: dict[str, Rule]


async def started(settings: Settings) -> App:
    """Return a server whose features take goals; it has no port, no arm and no planners."""
    app = App(settings)
    for feature in app.features:
        if feature.name == "goals":
            await feature.start()
    return app


@functools.cache
def server_rules(*arms: str) -> ServerRules:
    """Return the rules of a server with one arm, or with several by these names."""

    async def rules() -> ServerRules:
        app = await started(Settings.model_validate({"arms": {name: {} for name in arms}}))
        for feature in app.features:
            if feature.name == "the logs":
                await feature.stop()
        return ServerRules(app.graph.services.rules, app.graph.rules, app.graph.actions.rules)

    # Another event loop may run in this thread.
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(asyncio.run, rules()).result()


def with_server_rules(graph: Graph, *arms: str) -> Graph:
    """Give the names of a graph the rules of a server."""
    services, topics, actions = server_rules(*arms)
    graph.services.rules |= services
    graph.rules |= topics
    graph.actions.rules |= actions
    return graph
