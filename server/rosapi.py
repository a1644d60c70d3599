"""The services of rosapi (``/rosapi/...``): topics, services, actions, nodes, types and parameters."""

from __future__ import annotations

import json
import re
import socket
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, TypeAlias

from protocol.dialect import Dialect, spell_type
from protocol.errors import InterfaceError
from protocol.messages import Stamp
from protocol.operations import qualify
from protocol.type_descriptions import full_text, typedefs
from server.access.permissions import NameFilter
from server.errors import ServiceError
from server.graph.node import Node
from server.graph.services import LOCAL_TIMEOUT_S, Call, answer
from server.graph.topics import Graph

NODE = Node("rosapi")

# Answers of get_ros_version, by the client's dialect. Clients look releases up in lists of their own; these are in all.
ROS_VERSIONS: Mapping[Dialect, dict[str, Any]] = {
    "ros2": {"version": 2, "distro": "jazzy"},
    "ros1": {"version": 1, "distro": "noetic"},
}

# Of all texts in one response: those of 4000 types of average length, or of 380 of the longest. Without a limit, a
# client that advertises thousands of topics would make every response expensive for everybody.
MAX_TEXTS_CHARACTERS = 4 << 20

# As many as any robot's parameter server has.
MAX_PARAMETERS = 10_000

# Names and values of all parameters together: a robot's description and the settings of all its controllers.
MAX_PARAMETER_BYTES = 16 << 20


class Request(NamedTuple):
    """Request of a rosapi service.

    Attributes:
        values: the complete request message.
        dialect: the caller's; type names in the response are spelled in it.
    """

    values: Mapping[str, Any]
    dialect: Dialect

    def name(self, field: str) -> str:
        """Return the fully qualified name in a field of the request."""
        return qualify(self.values[field])

    def spell(self, type_name: str) -> str:
        """Spell a canonical type name, or the empty text that stands for none, in the caller's dialect."""
        return spell_type(type_name, self.dialect)

    def spell_all(self, type_names: Iterable[str]) -> list[str]:
        """Spell canonical type names in the caller's dialect."""
        return [spell_type(type_name, self.dialect) for type_name in type_names]


# Returns the response's fields; raises ServiceError to fail the call.
Handler: TypeAlias = Callable[[Request], dict[str, Any]]

# Service name below /rosapi -> service type and handler.
Handlers: TypeAlias = Mapping[str, tuple[str, Handler]]


class RosApi:
    """Offers the services of rosapi on a graph.

    Args:
        graph: topics, services and actions to describe; the services are offered here as well.
        wall_clock: seconds since the epoch.
        params: parameters that clients may use; None for all.

    Attributes:
        parameters: parameters that clients and the server keep.
    """

    def __init__(
        self, graph: Graph, wall_clock: Callable[[], float] = time.time, params: NameFilter | None = None
    ) -> None:
        self.parameters = Parameters(params)
        self._graph = graph
        self._services = graph.services
        self._actions = graph.actions
        self._registry = graph.message_types.registry
        self._wall_clock = wall_clock
        # Foxglove asks for the texts of all topics every three seconds; there are no more types than the registry has.
        self._texts: dict[tuple[str, Dialect], str] = {}
        handlers: Handlers = {
            "topics": ("rosapi_msgs/srv/Topics", self._topics),
            "topics_for_type": ("rosapi_msgs/srv/TopicsForType", self._topics_for_type),
            "topics_and_raw_types": ("rosapi_msgs/srv/TopicsAndRawTypes", self._topics_and_raw_types),
            "topic_type": ("rosapi_msgs/srv/TopicType", self._topic_type),
            "publishers": ("rosapi_msgs/srv/Publishers", self._publishers),
            "subscribers": ("rosapi_msgs/srv/Subscribers", self._subscribers),
            "services": ("rosapi_msgs/srv/Services", lambda _: {"services": sorted(self._services.types())}),
            "services_for_type": ("rosapi_msgs/srv/ServicesForType", self._services_for_type),
            "service_type": ("rosapi_msgs/srv/ServiceType", self._service_type),
            "service_providers": ("rosapi_msgs/srv/ServiceProviders", self._service_providers),
            "service_node": ("rosapi_msgs/srv/ServiceNode", self._service_node),
            # In ROS 1 only.
            "service_host": ("rosapi/srv/ServiceHost", self._service_host),
            "action_servers": (
                "rosapi_msgs/srv/GetActionServers",
                lambda _: {"action_servers": sorted(self._actions.types())},
            ),
            "nodes": ("rosapi_msgs/srv/Nodes", self._nodes),
            "node_details": ("rosapi_msgs/srv/NodeDetails", self._node_details),
            "message_details": ("rosapi_msgs/srv/MessageDetails", self._message_details),
            "service_request_details": ("rosapi_msgs/srv/ServiceRequestDetails", self._service_request_details),
            "service_response_details": ("rosapi_msgs/srv/ServiceResponseDetails", self._service_response_details),
            "get_time": ("rosapi_msgs/srv/GetTime", self._get_time),
            "get_ros_version": ("rosapi_msgs/srv/GetROSVersion", lambda request: ROS_VERSIONS[request.dialect]),
            **self.parameters.handlers,
        }
        for name, (type_name, handler) in handlers.items():
            self._services.offer_calls(NODE, f"/rosapi/{name}", type_name, _responder(handler), LOCAL_TIMEOUT_S)

    # Topics.

    def _topics(self, request: Request) -> dict[str, Any]:
        types = self._graph.topic_types()
        return {"topics": list(types), "types": request.spell_all(types.values())}

    def _topics_for_type(self, request: Request) -> dict[str, Any]:
        return {"topics": names_of_type(self._graph.topic_types(), request.values["type"])}

    def _topics_and_raw_types(self, request: Request) -> dict[str, Any]:
        types = self._graph.topic_types()
        texts = _limited(self._full_text(type_name, request.dialect) for type_name in types.values())
        return {"topics": list(types), "types": request.spell_all(types.values()), "typedefs_full_text": texts}

    def _full_text(self, type_name: str, dialect: Dialect) -> str:
        text = self._texts.get((type_name, dialect))
        if text is None:
            try:
                text = self._texts[type_name, dialect] = full_text(self._registry, type_name, dialect)
            except InterfaceError:
                # A type that is relayed without being known.
                return ""
        return text

    def _topic_type(self, request: Request) -> dict[str, Any]:
        return {"type": request.spell(self._graph.topic_types().get(request.name("topic"), ""))}

    def _publishers(self, request: Request) -> dict[str, Any]:
        return {"publishers": _node_names(self._graph.publishers(request.name("topic")))}

    def _subscribers(self, request: Request) -> dict[str, Any]:
        return {"subscribers": _node_names(self._graph.subscribers(request.name("topic")))}

    # Services.

    def _services_for_type(self, request: Request) -> dict[str, Any]:
        return {"services": names_of_type(self._services.types(), request.values["type"])}

    def _service_type(self, request: Request) -> dict[str, Any]:
        return {"type": request.spell(self._services.type_of(request.name("service")) or "")}

    def _service_providers(self, request: Request) -> dict[str, Any]:
        """Return the providers of a type, which is in the field ``service`` (as in rosapi)."""
        names = names_of_type(self._services.types(), request.values["service"])
        providers = map(self._services.provider, names)
        return {"providers": _node_names(provider for provider in providers if provider is not None)}

    def _service_node(self, request: Request) -> dict[str, Any]:
        provider = self._services.provider(request.name("service"))
        return {"node": "" if provider is None else node_name(provider)}

    def _service_host(self, request: Request) -> dict[str, Any]:
        """Return this host: every service is reached through this server."""
        provider = self._services.provider(request.name("service"))
        return {"host": "" if provider is None else socket.gethostname()}

    # Nodes.

    def _nodes(self, _request: Request) -> dict[str, Any]:
        topics = self._graph.topic_types()
        publishers = (node for topic in topics for node in self._graph.publishers(topic))
        subscribers = (node for topic in topics for node in self._graph.subscribers(topic))
        providers = (self._services.provider(name) for name in self._services.types())
        nodes = {*publishers, *subscribers, *(provider for provider in providers if provider is not None)}
        return {"nodes": _node_names(nodes)}

    def _node_details(self, request: Request) -> dict[str, Any]:
        name = request.values["node"]
        topics = self._graph.topic_types()
        return {
            "publishing": [topic for topic in topics if name in map(node_name, self._graph.publishers(topic))],
            "subscribing": [topic for topic in topics if name in map(node_name, self._graph.subscribers(topic))],
            "services": [service for service in self._services.types() if self._provides(name, service)],
        }

    def _provides(self, name: str, service: str) -> bool:
        provider = self._services.provider(service)
        return provider is not None and node_name(provider) == name

    # Types, as the caller's dialect declares them.

    def _message_details(self, request: Request) -> dict[str, Any]:
        return self._typedefs(request, lambda name: name)

    def _service_request_details(self, request: Request) -> dict[str, Any]:
        return self._typedefs(request, lambda name: f"{self._registry.canonical(name, 'srv')}_Request")

    def _service_response_details(self, request: Request) -> dict[str, Any]:
        return self._typedefs(request, lambda name: f"{self._registry.canonical(name, 'srv')}_Response")

    def _typedefs(self, request: Request, message_of: Callable[[str], str]) -> dict[str, Any]:
        try:
            return {"typedefs": typedefs(self._registry, message_of(request.values["type"]), request.dialect)}
        except InterfaceError as error:
            raise ServiceError(str(error)) from error

    # The server.

    def _get_time(self, _request: Request) -> dict[str, Any]:
        return {"time": Stamp.from_seconds(self._wall_clock()).as_message()}


class Parameters:
    """Parameters: JSON texts by name, kept for the life of the server.

    Args:
        names: parameters that clients may use; None for all.

    Attributes:
        handlers: the services that read and change parameters.
    """

    def __init__(self, names: NameFilter | None = None) -> None:
        self._names = names or NameFilter("access.params_glob")
        self._values: dict[str, str] = {}
        self._size_bytes = 0
        self.handlers: Handlers = {
            "set_param": ("rosapi_msgs/srv/SetParam", self._set_param),
            "get_param": ("rosapi_msgs/srv/GetParam", self._get_param),
            "has_param": ("rosapi_msgs/srv/HasParam", self._has_param),
            "delete_param": ("rosapi_msgs/srv/DeleteParam", self._delete_param),
            "get_param_names": ("rosapi_msgs/srv/GetParamNames", self._get_param_names),
            # In ROS 1 only.
            "search_param": ("rosapi/srv/SearchParam", self._search_param),
        }

    def keep(self, name: str, value: str) -> None:
        """Set a parameter of the server itself, without the limits that hold for clients.

        Args:
            name: fully qualified.
            value: JSON text.
        """
        self._size_bytes += _size_bytes(name, value) - self._stored_bytes(name)
        self._values[name] = value

    def _set_param(self, request: Request) -> dict[str, Any]:
        name, value = self._allowed_name(request), request.values["value"]
        if name not in self._values and len(self._values) >= MAX_PARAMETERS:
            raise ServiceError(f"name: there are {MAX_PARAMETERS} parameters already, the limit")
        size_bytes = self._size_bytes + _size_bytes(name, value) - self._stored_bytes(name)
        if size_bytes > MAX_PARAMETER_BYTES:
            raise ServiceError(f"value: {size_bytes} bytes of parameters with it, the limit is {MAX_PARAMETER_BYTES}")
        try:
            json.loads(value)
        # Text that nests too deep exceeds the parser's recursion limit.
        except (ValueError, RecursionError) as error:
            raise ServiceError(f"value: must be JSON text: {error}") from error
        self._values[name] = value
        self._size_bytes = size_bytes
        return {}

    def _get_param(self, request: Request) -> dict[str, Any]:
        return {"value": self._values.get(self._allowed_name(request), request.values["default_value"])}

    def _has_param(self, request: Request) -> dict[str, Any]:
        return {"exists": self._allowed_name(request) in self._values}

    def _delete_param(self, request: Request) -> dict[str, Any]:
        name = self._allowed_name(request)
        self._size_bytes -= self._stored_bytes(name)
        self._values.pop(name, None)
        return {}

    def _search_param(self, request: Request) -> dict[str, Any]:
        """Return the name itself if it exists: there are no namespaces to search upwards."""
        name = self._allowed_name(request)
        return {"global_name": name if name in self._values else ""}

    def _get_param_names(self, _request: Request) -> dict[str, Any]:
        return {"names": sorted(name for name in self._values if self._names.refusal("parameter", name) is None)}

    def _allowed_name(self, request: Request) -> str:
        """Return the name of the requested parameter.

        Raises:
            ServiceError: clients may not use it.
        """
        name: str = request.values["name"]
        refusal = self._names.refusal("parameter", name)
        if refusal is not None:
            raise ServiceError(refusal)
        return name

    def _stored_bytes(self, name: str) -> int:
        return _size_bytes(name, self._values[name]) if name in self._values else 0


def names_of_type(types: Mapping[str, str], wanted: str) -> list[str]:
    """Return the names that have a type, in alphabetical order; none for an unknown type.

    Args:
        types: canonical type of each name.
        wanted: a type in the spelling of either dialect.
    """
    # Both spellings can be converted to that of ROS 1.
    spelled = spell_type(wanted, "ros1")
    return sorted(name for name, type_name in types.items() if spell_type(type_name, "ros1") == spelled)


def node_name(node: Node) -> str:
    """Return a node's name as ROS spells names."""
    return "/" + re.sub(r"\W+", "_", node.name).strip("_")


def _node_names(nodes: Iterable[Node]) -> list[str]:
    return sorted({node_name(node) for node in nodes})


def _responder(handler: Handler) -> Callable[[Call], None]:
    return lambda call: answer(call, lambda values: handler(Request(values, call.dialect)))


def _limited(texts: Iterable[str]) -> list[str]:
    """Replace texts beyond `MAX_TEXTS_CHARACTERS` in all by empty ones."""
    kept = []
    left = MAX_TEXTS_CHARACTERS
    for text in texts:
        kept.append(text if len(text) <= left else "")
        left -= len(kept[-1])
    return kept


def _size_bytes(name: str, value: str) -> int:
    return len(name.encode()) + len(value.encode())
