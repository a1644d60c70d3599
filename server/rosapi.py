"""The services under ``/rosapi/``: what topics, services, types, nodes and parameters there are."""

from __future__ import annotations

import json
import re
import socket
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from protocol.errors import InterfaceError
from protocol.interface_text import full_text, typedefs
from protocol.messages import Stamp
from protocol.names import qualify
from protocol.registry import Registry
from server.actions import Actions
from server.errors import ServiceError
from server.graph import Graph
from server.node import Node
from server.services import Services

NODE = Node("rosapi")

ROS_VERSION = 2

# Clients look its name up in lists of their own; this release is in all of them.
ROS_DISTRO = "jazzy"

# As many as any robot's parameter server has, and 1 MiB at the most of each.
MAX_PARAMETERS = 10_000
MAX_PARAMETER_BYTES = 1 << 20

Request = Mapping[str, Any]
Answer = dict[str, Any]


class RosApi:
    """Answers questions about the graph.

    Args:
        graph: topics.
        services: services, and where these are offered.
        actions: actions.
        registry: types.
        wall_clock: seconds since the epoch.
    """

    def __init__(
        self,
        graph: Graph,
        services: Services,
        actions: Actions,
        registry: Registry,
        wall_clock: Callable[[], float],
    ) -> None:
        self._graph = graph
        self._services = services
        self._actions = actions
        self._registry = registry
        self._wall_clock = wall_clock
        self._parameters: dict[str, str] = {}
        # Foxglove asks for the texts of all topics every three seconds; there are no more types than the tables hold.
        self._texts: dict[str, str] = {}

    def open(self) -> None:
        """Offer every service."""
        for name, (type_name, answer) in self._table().items():
            self._services.offer(
                NODE, f"/rosapi/{name}", type_name if "/" in type_name else f"rosapi_msgs/srv/{type_name}", answer
            )

    def _table(self) -> dict[str, tuple[str, Callable[[Request], Answer]]]:
        """Service name -> its type in rosapi_msgs, or a full name where only ROS 1 has it; and what answers it."""
        return {
            "topics": ("Topics", self._topics),
            "topics_for_type": ("TopicsForType", lambda asked: {"topics": self._of_type(self._topic_types(), asked)}),
            "topics_and_raw_types": ("TopicsAndRawTypes", self._topics_and_raw_types),
            "topic_type": ("TopicType", lambda asked: {"type": self._topic_types().get(qualify(asked["topic"]), "")}),
            "services": ("Services", lambda _: {"services": sorted(self._services.types())}),
            "services_for_type": (
                "ServicesForType",
                lambda asked: {"services": self._of_type(self._services.types(), asked)},
            ),
            "service_type": ("ServiceType", self._service_type),
            "service_providers": ("ServiceProviders", self._service_providers),
            "service_node": ("ServiceNode", self._service_node),
            "nodes": ("Nodes", lambda _: {"nodes": sorted(map(node_name, self._nodes()))}),
            "node_details": ("NodeDetails", self._node_details),
            "publishers": ("Publishers", lambda asked: {"publishers": _names(self._graph.publishers(_topic(asked)))}),
            "subscribers": (
                "Subscribers",
                lambda asked: {"subscribers": _names(self._graph.subscribers(_topic(asked)))},
            ),
            "action_servers": ("GetActionServers", lambda _: {"action_servers": sorted(self._actions.types())}),
            "message_details": ("MessageDetails", lambda asked: self._details(asked["type"], "msg", "")),
            "service_request_details": (
                "ServiceRequestDetails",
                lambda asked: self._details(asked["type"], "srv", "_Request"),
            ),
            "service_response_details": (
                "ServiceResponseDetails",
                lambda asked: self._details(asked["type"], "srv", "_Response"),
            ),
            "get_time": ("GetTime", lambda _: {"time": Stamp.from_seconds(self._wall_clock()).as_message()}),
            "set_param": ("SetParam", self._set_param),
            "get_param": ("GetParam", self._get_param),
            "has_param": ("HasParam", lambda asked: {"exists": asked["name"] in self._parameters}),
            "delete_param": ("DeleteParam", self._delete_param),
            "get_param_names": ("GetParamNames", lambda _: {"names": sorted(self._parameters)}),
            "service_host": ("rosapi/srv/ServiceHost", self._service_host),
            "search_param": ("rosapi/srv/SearchParam", self._search_param),
            "get_ros_version": ("GetROSVersion", lambda _: {"version": ROS_VERSION, "distro": ROS_DISTRO}),
        }

    def _topic_types(self) -> Mapping[str, str]:
        return self._graph.topic_types()

    def _of_type(self, types: Mapping[str, str], asked: Request) -> list[str]:
        """Names whose type is the one asked for, in either spelling; none for a type nobody knows."""
        wanted = _two_parts(asked["type"])
        return sorted(name for name, type_name in types.items() if _two_parts(type_name) == wanted)

    def _topics(self, _asked: Request) -> Answer:
        types = self._topic_types()
        return {"topics": list(types), "types": list(types.values())}

    def _topics_and_raw_types(self, _asked: Request) -> Answer:
        types = self._topic_types()
        texts = [self._full_text(type_name) for type_name in types.values()]
        return {"topics": list(types), "types": list(types.values()), "typedefs_full_text": texts}

    def _full_text(self, type_name: str) -> str:
        text = self._texts.get(type_name)
        if text is None:
            try:
                text = self._texts[type_name] = full_text(self._registry, type_name)
            except InterfaceError:
                # A type that is relayed without being known.
                return ""
        return text

    def _service_type(self, asked: Request) -> Answer:
        return {"type": self._services.types().get(qualify(asked["service"]), "")}

    def _service_providers(self, asked: Request) -> Answer:
        """``service`` is the name of a type, whatever the field is called."""
        wanted = _two_parts(asked["service"])
        providers = (
            self._services.provider(name)
            for name, type_name in self._services.types().items()
            if _two_parts(type_name) == wanted
        )
        return {"providers": _names(provider for provider in providers if provider is not None)}

    def _service_node(self, asked: Request) -> Answer:
        provider = self._services.provider(qualify(asked["service"]))
        return {"node": "" if provider is None else node_name(provider)}

    def _service_host(self, asked: Request) -> Answer:
        """Every service is reached through this server."""
        provider = self._services.provider(qualify(asked["service"]))
        return {"host": "" if provider is None else socket.gethostname()}

    def _nodes(self) -> set[Node]:
        topics = self._topic_types()
        nodes = {node for topic in topics for node in (*self._graph.publishers(topic), *self._graph.subscribers(topic))}
        providers = (self._services.provider(name) for name in self._services.types())
        return nodes | {provider for provider in providers if provider is not None}

    def _node_details(self, asked: Request) -> Answer:
        wanted = asked["node"]
        topics = self._topic_types()
        return {
            "publishing": [t for t in topics if wanted in map(node_name, self._graph.publishers(t))],
            "subscribing": [t for t in topics if wanted in map(node_name, self._graph.subscribers(t))],
            "services": [
                name
                for name in self._services.types()
                if (provider := self._services.provider(name)) is not None and node_name(provider) == wanted
            ],
        }

    def _details(self, type_name: str, kind: str, member: str) -> Answer:
        """TypeDefs of a message type, or of a member of a service type."""
        try:
            name = type_name if kind == "msg" else f"{self._registry.service(type_name).name}{member}"
            return {"typedefs": typedefs(self._registry, name)}
        except InterfaceError as error:
            raise ServiceError(str(error)) from error

    def _set_param(self, asked: Request) -> Answer:
        name, value = asked["name"], asked["value"]
        size_bytes = len(value.encode())
        if size_bytes > MAX_PARAMETER_BYTES:
            raise ServiceError(f"value: {size_bytes} bytes, the limit is {MAX_PARAMETER_BYTES}")
        if name not in self._parameters and len(self._parameters) >= MAX_PARAMETERS:
            raise ServiceError(f"name: there are {MAX_PARAMETERS} parameters already, the limit")
        try:
            json.loads(value)
        except ValueError as error:
            raise ServiceError(f"value: must be JSON text: {error}") from error
        self._parameters[name] = value
        return {}

    def _get_param(self, asked: Request) -> Answer:
        return {"value": self._parameters.get(asked["name"], asked["default_value"])}

    def _search_param(self, asked: Request) -> Answer:
        """There are no namespaces here: a parameter is found where it is, or not at all."""
        return {"global_name": asked["name"] if asked["name"] in self._parameters else ""}

    def _delete_param(self, asked: Request) -> Answer:
        self._parameters.pop(asked["name"], None)
        return {}


def node_name(node: Node) -> str:
    """A node's name as ROS spells names."""
    return "/" + re.sub(r"\W+", "_", node.name).strip("_")


def _names(nodes: Iterable[Node]) -> list[str]:
    return sorted({node_name(node) for node in nodes})


def _topic(asked: Request) -> str:
    return qualify(asked["topic"])


def _two_parts(type_name: str) -> str:
    first, *rest = type_name.split("/")
    return f"{first}/{rest[-1]}" if rest else first
