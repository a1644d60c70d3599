"""Who takes part in the graph and with what: topics, services, actions and nodes."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterable
from typing import Any

from server.graph.actions import Actions
from server.graph.node import Node
from server.graph.services import Services
from server.graph.topics import Graph
from server.rosapi.question import Answers, Question, of_type


class Topics:
    """Answers questions about topics.

    Args:
        graph: where they are.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.answers: Answers = {
            "topics": ("rosapi_msgs/srv/Topics", self._topics),
            "topics_for_type": ("rosapi_msgs/srv/TopicsForType", self._of_type),
            "topic_type": ("rosapi_msgs/srv/TopicType", self._type),
            "publishers": ("rosapi_msgs/srv/Publishers", self._publishers),
            "subscribers": ("rosapi_msgs/srv/Subscribers", self._subscribers),
        }

    def _topics(self, asked: Question) -> dict[str, Any]:
        types = self._graph.topic_types()
        return {"topics": list(types), "types": asked.spell_all(types.values())}

    def _of_type(self, asked: Question) -> dict[str, Any]:
        return {"topics": of_type(self._graph.topic_types(), asked.request["type"])}

    def _type(self, asked: Question) -> dict[str, Any]:
        return {"type": asked.spell(self._graph.topic_types().get(asked.name("topic"), ""))}

    def _publishers(self, asked: Question) -> dict[str, Any]:
        return {"publishers": _names(self._graph.publishers(asked.name("topic")))}

    def _subscribers(self, asked: Question) -> dict[str, Any]:
        return {"subscribers": _names(self._graph.subscribers(asked.name("topic")))}


class Offered:
    """Answers questions about services and actions.

    Args:
        services: what is offered and by whom.
        actions: likewise.
    """

    def __init__(self, services: Services, actions: Actions) -> None:
        self._services = services
        self._actions = actions
        self.answers: Answers = {
            "services": ("rosapi_msgs/srv/Services", lambda _: {"services": sorted(self._services.types())}),
            "services_for_type": ("rosapi_msgs/srv/ServicesForType", self._of_type),
            "service_type": ("rosapi_msgs/srv/ServiceType", self._type),
            "service_providers": ("rosapi_msgs/srv/ServiceProviders", self._providers),
            "service_node": ("rosapi_msgs/srv/ServiceNode", self._node),
            # Only ROS 1 has it.
            "service_host": ("rosapi/srv/ServiceHost", self._host),
            "action_servers": (
                "rosapi_msgs/srv/GetActionServers",
                lambda _: {"action_servers": sorted(self._actions.types())},
            ),
        }

    def _of_type(self, asked: Question) -> dict[str, Any]:
        return {"services": of_type(self._services.types(), asked.request["type"])}

    def _type(self, asked: Question) -> dict[str, Any]:
        return {"type": asked.spell(self._services.type_of(asked.name("service")) or "")}

    def _providers(self, asked: Question) -> dict[str, Any]:
        """``service`` is the name of a type, whatever the field is called."""
        providers = map(self._services.provider, of_type(self._services.types(), asked.request["service"]))
        return {"providers": _names(provider for provider in providers if provider is not None)}

    def _node(self, asked: Question) -> dict[str, Any]:
        provider = self._services.provider(asked.name("service"))
        return {"node": "" if provider is None else node_name(provider)}

    def _host(self, asked: Question) -> dict[str, Any]:
        """Every service is reached through this server."""
        provider = self._services.provider(asked.name("service"))
        return {"host": "" if provider is None else socket.gethostname()}


class Nodes:
    """Answers questions about nodes.

    Args:
        graph: topics.
        services: services.
    """

    def __init__(self, graph: Graph, services: Services) -> None:
        self._graph = graph
        self._services = services
        self.answers: Answers = {
            "nodes": ("rosapi_msgs/srv/Nodes", self._nodes),
            "node_details": ("rosapi_msgs/srv/NodeDetails", self._details),
        }

    def _nodes(self, _asked: Question) -> dict[str, Any]:
        publishers = (node for topic in self._graph.topic_types() for node in self._graph.publishers(topic))
        subscribers = (node for topic in self._graph.topic_types() for node in self._graph.subscribers(topic))
        providers = (self._services.provider(name) for name in self._services.types())
        nodes = {*publishers, *subscribers, *(provider for provider in providers if provider is not None)}
        return {"nodes": _names(nodes)}

    def _details(self, asked: Question) -> dict[str, Any]:
        wanted = asked.request["node"]
        topics = self._graph.topic_types()
        return {
            "publishing": [topic for topic in topics if wanted in map(node_name, self._graph.publishers(topic))],
            "subscribing": [topic for topic in topics if wanted in map(node_name, self._graph.subscribers(topic))],
            "services": [name for name in self._services.types() if self._offers(wanted, name)],
        }

    def _offers(self, wanted: str, service: str) -> bool:
        provider = self._services.provider(service)
        return provider is not None and node_name(provider) == wanted


def node_name(node: Node) -> str:
    """Return a node's name as ROS spells names."""
    return "/" + re.sub(r"\W+", "_", node.name).strip("_")


def _names(nodes: Iterable[Node]) -> list[str]:
    return sorted({node_name(node) for node in nodes})
