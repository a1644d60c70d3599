"""Who is connected, on the latched topics of rosbridge_server."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from protocol.messages import Stamp
from server.graph.node import Node
from server.graph.topics import Graph

COUNT_TOPIC = "/client_count"
LIST_TOPIC = "/connected_clients"


class ClientList:
    """The connected clients.

    Args:
        graph: where the topics are.
        wall_clock: seconds since the epoch.
    """

    def __init__(self, graph: Graph, wall_clock: Callable[[], float] = time.time) -> None:
        self._graph = graph
        self._wall_clock = wall_clock
        self._node = Node("rosbridge_websocket")
        self._clients: dict[Node, dict[str, Any]] = {}

    def open(self) -> None:
        """Advertise the topics and say that nobody is there yet."""
        self._graph.advertise(self._node, COUNT_TOPIC, "std_msgs/msg/Int32", latch=True)
        self._graph.advertise(self._node, LIST_TOPIC, "rosbridge_msgs/msg/ConnectedClients", latch=True)
        self._publish()

    def add(self, client: Node, address: str) -> None:
        """A client has connected from an address."""
        connected = Stamp.from_seconds(self._wall_clock()).as_message()
        self._clients[client] = {"ip_address": address, "connection_time": connected}
        self._publish()

    def remove(self, client: Node) -> None:
        """A client has left."""
        self._clients.pop(client, None)
        self._publish()

    def _publish(self) -> None:
        self._graph.publish(self._node, COUNT_TOPIC, {"data": len(self._clients)})
        self._graph.publish(self._node, LIST_TOPIC, {"clients": list(self._clients.values())})
