from __future__ import annotations

from typing import Any

from protocol.registry import Registry
from server.client_list import COUNT_TOPIC, LIST_TOPIC, ClientList
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber


def latest(graph: Graph, topic: str) -> Any:
    """What somebody who subscribes now gets."""
    return graph.subscribe(Node("late"), topic, None, Subscriber(lambda _publication: None))[-1].msg


def test_who_subscribes_late_learns_who_is_connected() -> None:
    graph = Graph(Registry.load())
    clients = ClientList(graph, wall_clock=lambda: 7.0)
    clients.open()
    assert latest(graph, COUNT_TOPIC) == {"data": 0}
    first, second = Node("a"), Node("b")
    clients.add(first, "10.0.0.1")
    clients.add(second, "10.0.0.2")
    assert latest(graph, COUNT_TOPIC) == {"data": 2}
    clients.remove(first)
    assert latest(graph, LIST_TOPIC) == {
        "clients": [{"ip_address": "10.0.0.2", "connection_time": {"sec": 7, "nanosec": 0}}]
    }
