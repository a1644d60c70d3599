"""View of the graph in which every name stands below a prefix, as in a ROS namespace.

The parts of one of several arms are made with it, and have the same names in their code as those of a single arm.
"""

from __future__ import annotations

from collections.abc import Callable

from protocol.publication import PublishedMessage
from server.graph.actions import Actions, Goal
from server.graph.list_limits import ListLimits
from server.graph.node import Node
from server.graph.services import DEFAULT_LIMITS, LOCAL_TIMEOUT_S, Call, ServiceFunction, Services
from server.graph.topics import Graph, Subscriber


class Namespace(Graph):
    """The graph below a prefix, for local parts: what they advertise, subscribe to, publish and offer.

    Everything else, as the lists of all topics, is a matter of the graph itself.

    Args:
        graph: the graph.
        name: of the namespace, without slashes.

    Attributes:
        services: services below the prefix.
        actions: actions likewise.
    """

    def __init__(self, graph: Graph, name: str) -> None:
        # Nothing of its own: topics, services and actions are the graph's.
        self._graph = graph
        self._prefix = f"/{name}"
        self.message_types = graph.message_types
        self.services = _ServicesBelow(graph.services, self._prefix)
        self.actions = _ActionsBelow(graph.actions, self._prefix)

    def resolve(self, name: str) -> str:
        """Return the fully qualified name of a name below the prefix."""
        return f"{self._prefix}{name}"

    def advertise(self, node: Node, name: str, type_name: str, *, latch: bool = False) -> None:
        """Register a publisher."""
        self._graph.advertise(node, self.resolve(name), type_name, latch=latch)

    def unadvertise(self, node: Node, name: str) -> None:
        """Forget a publisher."""
        self._graph.unadvertise(node, self.resolve(name))

    def subscribe(self, node: Node, name: str, type_name: str | None, subscriber: Subscriber) -> list[PublishedMessage]:
        """Deliver a topic's messages."""
        return self._graph.subscribe(node, self.resolve(name), type_name, subscriber)

    def unsubscribe(self, node: Node, name: str) -> None:
        """End the delivery."""
        self._graph.unsubscribe(node, self.resolve(name))

    def publish(
        self,
        node: Node,
        name: str,
        message: object,
        *,
        latch: bool = False,
        lifespan_s: float = 0.0,
        as_it_is: bool = False,
    ) -> str | None:
        """Publish a message."""
        where = self.resolve(name)
        return self._graph.publish(node, where, message, latch=latch, lifespan_s=lifespan_s, as_it_is=as_it_is)

    def tell(self, node: Node, name: str, message: object) -> None:
        """Deliver a message to one subscriber alone."""
        self._graph.tell(node, self.resolve(name), message)

    def publishers(self, name: str) -> list[Node]:
        """Return the publishers of a topic."""
        return self._graph.publishers(self.resolve(name))

    def subscribers(self, name: str) -> list[Node]:
        """Return the subscribers of a topic."""
        return self._graph.subscribers(self.resolve(name))

    def topic_type(self, name: str) -> str | None:
        """Return the canonical type of a topic."""
        return self._graph.topic_type(self.resolve(name))


class _ServicesBelow(Services):
    """Services below a prefix."""

    def __init__(self, services: Services, prefix: str) -> None:
        self._services = services
        self._prefix = prefix

    def offer(
        self,
        node: Node,
        name: str,
        type_name: str,
        function: ServiceFunction,
        timeout_s: float = LOCAL_TIMEOUT_S,
        limits: ListLimits = DEFAULT_LIMITS,
    ) -> None:
        """Offer a service."""
        self._services.offer(node, f"{self._prefix}{name}", type_name, function, timeout_s, limits)

    def offer_calls(
        self,
        node: Node,
        name: str,
        type_name: str,
        start: Callable[[Call], None],
        timeout_s: float = LOCAL_TIMEOUT_S,
        limits: ListLimits | None = DEFAULT_LIMITS,
    ) -> None:
        """Offer a service that answers its calls itself."""
        self._services.offer_calls(node, f"{self._prefix}{name}", type_name, start, timeout_s, limits)


class _ActionsBelow(Actions):
    """Actions below a prefix."""

    def __init__(self, actions: Actions, prefix: str) -> None:
        self._actions = actions
        self._prefix = prefix

    def offer(
        self,
        node: Node,
        name: str,
        type_name: str,
        start: Callable[[Goal], None],
        limits: ListLimits | None = None,
    ) -> None:
        """Offer an action."""
        self._actions.offer(node, f"{self._prefix}{name}", type_name, start, limits)
