"""A client of a graph in the test's own process: calls, and what is published."""

import asyncio
from typing import Any

from harness.waiting import TIMEOUT_S
from server.graph.permissions import Node
from server.graph.services import Response
from server.graph.topics import Graph, Subscriber


async def called(graph: Graph, service: str, **request: Any) -> Response:
    """Return the response to a call."""
    answered: asyncio.Future[Response] = asyncio.get_running_loop().create_future()
    graph.services.call(Node("client"), service, request, answered.set_result)
    return await asyncio.wait_for(answered, TIMEOUT_S)


def answered(graph: Graph, service: str, caller: Node | None = None, **request: Any) -> Response:
    """Return the response to a call that is answered at once."""
    responses: list[Response] = []
    graph.services.call(caller or Node("client"), service, request, responses.append)
    (response,) = responses
    return response


def listen(graph: Graph, topic: str, type_name: str | None = None, node: Node | None = None) -> list[Any]:
    """Return the messages that a node hears on a topic: the latched one, and those that come from now on."""
    heard: list[Any] = []
    subscriber = Subscriber(lambda published: heard.append(published.msg))
    heard += [latched.msg for latched in graph.subscribe(node or Node("viewer"), topic, type_name, subscriber)]
    return heard
