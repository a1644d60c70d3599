"""The graph as parts of the server see it: every name stands below a prefix, as in a ROS namespace.

The prefix of an arm that is alone is empty; the parts of one of several arms use the same names in their code.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from protocol.publication import PublishedMessage
from server.graph.actions import ActionGoal
from server.graph.list_limits import ListLimits
from server.graph.message_types import MessageTypes
from server.graph.node import Node
from server.graph.permissions import Rule
from server.graph.services import LOCAL_TIMEOUT_S, Call, ServiceFunction
from server.graph.topics import Graph, Subscriber


class LocalGraph:
    """The graph below a prefix; each method is the graph's own, with the full name in place of the one given."""

    def __init__(self, graph: Graph, namespace: str = "") -> None:
        self._graph = graph
        self._prefix = f"/{namespace}" if namespace else ""
        self.message_types: MessageTypes = graph.message_types

    def resolve(self, name: str) -> str:
        return f"{self._prefix}{name}"

    def advertise(self, node: Node, name: str, type_name: str, *, latch: bool = False) -> None:
        self._graph.advertise(node, self.resolve(name), type_name, latch=latch)

    def subscribe(self, node: Node, name: str, type_name: str, subscriber: Subscriber) -> list[PublishedMessage]:
        if subscriber.rule is not None:
            subscriber = replace(subscriber, rule=self._below(subscriber.rule))
        return self._graph.subscribe(node, self.resolve(name), type_name, subscriber)

    def publish(self, node: Node, name: str, message: object, *, prevalidated: bool = False) -> None:
        self._graph.publish(node, self.resolve(name), message, prevalidated=prevalidated)

    def tell(self, node: Node, name: str, message: object) -> None:
        self._graph.tell(node, self.resolve(name), message)

    def publishers(self, name: str) -> list[Node]:
        return self._graph.publishers(self.resolve(name))

    def subscribers(self, name: str) -> list[Node]:
        return self._graph.subscribers(self.resolve(name))

    def offer(
        self, node: Node, name: str, type_name: str, function: ServiceFunction, *limits: ListLimits, rule: Rule
    ) -> None:
        self._graph.services.offer(
            node, self.resolve(name), type_name, function, LOCAL_TIMEOUT_S, *limits, rule=self._below(rule)
        )

    def offer_calls(
        self, node: Node, name: str, type_name: str, start: Callable[[Call], None], *limits: Any, rule: Rule
    ) -> None:
        """Offer a service that answers its calls itself, within a time [s] and with limits of its lists."""
        self._graph.services.offer_calls(node, self.resolve(name), type_name, start, *limits, rule=self._below(rule))

    def offer_action(
        self,
        node: Node,
        name: str,
        type_name: str,
        start: Callable[[ActionGoal], None],
        *limits: ListLimits,
        rule: Rule,
    ) -> None:
        self._graph.actions.offer(node, self.resolve(name), type_name, start, *limits, rule=self._below(rule))

    def _below(self, rule: Rule) -> Rule:
        return replace(rule, arm=self._prefix.removeprefix("/"))
