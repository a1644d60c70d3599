"""A graph with two nodes, and rosapi to ask about it."""

from __future__ import annotations

from typing import Any

from protocol.dialect import Dialect
from protocol.registry import Registry
from server.graph.node import Node
from server.graph.services import Response
from server.graph.topics import Graph, Subscriber
from server.rosapi import RosApi
from tests.helpers.clock import FakeClock

REGISTRY = Registry.load()
ARM, CLIENT = Node("arm"), Node("client 127.0.0.1:53944", remote=True)


class AskedWorld:
    """The graph, in a time that stands still."""

    def __init__(self) -> None:
        self.graph = Graph(
            REGISTRY, wall_clock=lambda: 12.5, call_later=FakeClock().call_later, relay_unknown_types=True
        )
        RosApi(self.graph, lambda: 12.5)
        self.graph.advertise(ARM, "/joint_states", "sensor_msgs/JointState")
        self.graph.subscribe(CLIENT, "/joint_states", None, Subscriber(lambda _published: None))
        self.graph.advertise(CLIENT, "/chatter", "std_msgs/String")
        self.graph.services.offer(ARM, "/arm/stop", "std_srvs/Trigger", lambda _request: {"success": True})

    def ask(self, service: str, dialect: Dialect = "ros2", /, **arguments: Any) -> dict[str, Any]:
        response = self.response(service, arguments, dialect)
        assert response.ok, response.values
        values: dict[str, Any] = response.values
        return values

    def response(self, service: str, arguments: Any, dialect: Dialect = "ros2") -> Response:
        responses: list[Response] = []
        self.graph.services.call(CLIENT, f"/rosapi/{service}", arguments, responses.append, dialect=dialect)
        assert len(responses) == 1
        return responses[0]
