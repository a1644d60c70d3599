"""The services of rosapi (``/rosapi/...``): topics, services, actions, nodes, types and parameters."""

import functools
import itertools
import json
import re
import socket
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, TypeAlias

from protocol.dialect import Dialect, spell_type
from protocol.errors import InterfaceError
from protocol.operations import qualify
from protocol.registry import Kind
from protocol.type_descriptions import full_text, typedefs
from server.errors import ServiceError
from server.graph.index import TypedNames, is_hidden
from server.graph.permissions import CONFIGURING, LOOKING, Node
from server.graph.providers import CompleteResponse
from server.graph.services import Call, failure_answered
from server.graph.topics import Graph

# Answers of get_ros_version, by the client's dialect. Clients look releases up in lists of their own; these are in all.
ROS_VERSIONS: Mapping[Dialect, dict[str, Any]] = {
    "ros2": {"version": 2, "distro": "jazzy"},
    "ros1": {"version": 1, "distro": "noetic"},
}

# Word in the names of services, kind of the type, and its members.
MEMBERS: tuple[tuple[str, Kind, tuple[str, ...]], ...] = (
    ("service", "srv", ("Request", "Response")),
    ("action", "action", ("Goal", "Result", "Feedback")),
)

# All texts in one response: 4000 types of average length, or 380 of the longest. Without a limit, a client that
# advertises thousands of topics would make every response expensive for everybody.
MAX_TEXTS_CHARACTERS = 4 << 20

# Names of nodes that are kept as ROS spells them: far more than clients connect.
MAX_NODE_NAMES = 8192

# As many as any robot's parameter server has.
MAX_PARAMETERS = 10_000

# Value of a missing parameter, of a request without a default. Clients read every value as JSON.
NO_PARAMETER = "null"

# Fields of rosapi's answers about parameters since 2025.
DONE = {"successful": True, "reason": ""}

# Names and values of all parameters together: a robot's description and the settings of all its controllers.
MAX_PARAMETER_BYTES = 16 << 20


class Request(NamedTuple):
    """Request of a rosapi service."""

    values: Mapping[str, Any]
    dialect: Dialect

    def name(self, field: str) -> str:
        return qualify(self.values[field])


# Services that change parameters.
CHANGING = frozenset(("set_param", "delete_param"))

# Returns the complete response, which nobody changes from then on; raises ServiceError to fail the call.
Handler: TypeAlias = Callable[[Request], dict[str, Any]]

# Handlers by their services' names below /rosapi.
Handlers: TypeAlias = dict[str, Handler]

# Types that are not named after their services, and types of ROS 1 alone.
TYPES = {
    "action_servers": "rosapi_msgs/srv/GetActionServers",
    "get_ros_version": "rosapi_msgs/srv/GetROSVersion",
    "search_param": "rosapi/srv/SearchParam",
    "service_host": "rosapi/srv/ServiceHost",
}


class RosApi:
    """Offers the services of rosapi on a graph."""

    def __init__(self, graph: Graph) -> None:
        self.parameters = Parameters()
        self._graph = graph
        self._services = graph.services
        self._registry = graph.message_types.registry
        handlers = self._of_topics() | self._of_services() | self._of_types() | self.parameters.handlers
        node = graph.node("rosapi")
        for name, handler in handlers.items():
            rule = CONFIGURING if name in CHANGING else LOOKING
            type_name = TYPES.get(name) or f"rosapi_msgs/srv/{name.title().replace('_', '')}"
            node.offer_calls(f"/rosapi/{name}", type_name, _responder(handler), rule=rule)

    def _of_topics(self) -> Handlers:
        graph, topics = self._graph, self._graph.topic_names
        return {
            "topics": lambda request: self._topics(request.dialect),
            "topics_for_type": lambda request: {"topics": _shown(topics.of_type(request.values["type"]))},
            "topics_and_raw_types": self._topics_and_raw_types,
            "topic_type": _type_answer(topics, "topic"),
            "publishers": lambda request: {"publishers": _node_names(graph.publishers(request.name("topic")))},
            "subscribers": lambda request: {"subscribers": _node_names(graph.subscribers(request.name("topic")))},
            "nodes": lambda _: {"nodes": _node_names(graph.nodes())},
            "node_details": self._node_details,
        }

    def _of_services(self) -> Handlers:
        services, actions, providers = self._services.names, self._graph.actions.names, self._services.providers_of_type
        return {
            "services": lambda _: {"services": sorted(services.shown_types())},
            "services_for_type": lambda request: {"services": _shown(services.of_type(request.values["type"]))},
            "service_type": _type_answer(services, "service"),
            # The field ``service`` has a type, as in rosapi.
            "service_providers": lambda request: {"providers": _node_names(providers(request.values["service"]))},
            "service_node": self._service_node,
            "service_host": self._service_host,
            "action_servers": lambda _: {"action_servers": sorted(actions.types())},
            "action_type": _type_answer(actions, "action"),
        }

    def _of_types(self) -> Handlers:
        details = {
            f"{kind}_{part.lower()}_details": self._details_answer(type_kind, f"_{part}")
            for kind, type_kind, parts in MEMBERS
            for part in parts
        }
        return {
            "message_details": self._details_answer("msg", ""),
            **details,
            "interfaces": self._interfaces,
            "get_time": lambda _: {"time": self._graph.message_types.now().as_message()},
            "get_ros_version": lambda request: ROS_VERSIONS[request.dialect],
        }

    def _topics(self, dialect: Dialect) -> dict[str, Any]:
        types = self._graph.topic_names.shown_types(dialect)
        return {"topics": list(types), "types": list(types.values())}

    def _topics_and_raw_types(self, request: Request) -> dict[str, Any]:
        answer, known = self._topics(request.dialect), self._graph.topic_names.types()
        types = [known[name] for name in answer["topics"]]
        # A type that is relayed without being known has no text.
        texts = {
            name: full_text(self._registry, name, request.dialect) if self._registry.knows(name) else ""
            for name in set(types)
        }
        return {**answer, "typedefs_full_text": _limited([texts[name] for name in types])}

    def _service_node(self, request: Request) -> dict[str, Any]:
        provider = self._services.provider(request.name("service"))
        return {"node": "" if provider is None else node_name(provider.name)}

    def _service_host(self, request: Request) -> dict[str, Any]:
        """Return this host: every service is reached through this server."""
        provider = self._services.provider(request.name("service"))
        return {"host": "" if provider is None else socket.gethostname()}

    def _node_details(self, request: Request) -> dict[str, Any]:
        name, graph = request.values["node"], self._graph
        # Several clients may have one name as ROS spells it.
        nodes = [node for node in graph.nodes() if node_name(node.name) == name]
        return {
            "subscribing": _joined(map(graph.subscriptions.of, nodes)),
            "publishing": _joined(map(graph.publications.of, nodes)),
            "services": _joined(map(self._services.provided_by, nodes)),
        }

    def _details_answer(self, kind: Kind, member: str) -> Handler:
        def details(request: Request) -> dict[str, Any]:
            try:
                message = f"{self._registry.canonical(request.values['type'], kind)}{member}"
                return {"typedefs": typedefs(self._registry, message, request.dialect)}
            except InterfaceError as error:
                raise ServiceError(str(error)) from error

        return details

    def _interfaces(self, request: Request) -> dict[str, Any]:
        registry = self._registry.ros1 if request.dialect == "ros1" else self._registry
        return {"interfaces": sorted(spell_type(name, request.dialect) for name in registry.type_names())}


class Parameters:
    """Parameters: JSON texts by name, kept for the life of the server."""

    def __init__(self) -> None:
        self._values: dict[str, str] = {}
        self._size_bytes = 0
        self.handlers: Handlers = {
            "set_param": self._set_param,
            "get_param": self._get_param,
            "has_param": lambda request: {"exists": _parameter_name(request) in self._values},
            "delete_param": self._delete_param,
            "get_param_names": lambda _: {"names": sorted(self._values)},
            "search_param": self._search_param,
        }

    def keep(self, name: str, value: str) -> None:
        """Set a parameter of the server itself, without the limits that hold for clients."""
        self._size_bytes += _size_bytes(name, value) - self._stored_bytes(name)
        self._values[name] = value

    def _set_param(self, request: Request) -> dict[str, Any]:
        name, value = _parameter_name(request), request.values["value"]
        if name not in self._values and len(self._values) >= MAX_PARAMETERS:
            raise ServiceError(f"name: there are {MAX_PARAMETERS} parameters already, the limit")
        size_bytes = self._size_bytes + _size_bytes(name, value) - self._stored_bytes(name)
        if size_bytes > MAX_PARAMETER_BYTES:
            raise ServiceError(f"value: {size_bytes} bytes of parameters with it, the limit is {MAX_PARAMETER_BYTES}")
        try:
            json.loads(value)
        except (ValueError, RecursionError) as error:
            raise ServiceError(f"value: must be JSON text: {error}") from error
        self._values[name] = value
        self._size_bytes = size_bytes
        return DONE

    def _get_param(self, request: Request) -> dict[str, Any]:
        """Return a parameter, or the default of the request; a missing value is JSON text too, as in rosapi."""
        name, default = _parameter_name(request), request.values["default_value"]
        value = self._values.get(name)
        if value is not None:
            return {"value": value, **DONE}
        if default:
            return {"value": _as_json(default), **DONE}
        return {"value": NO_PARAMETER, "successful": False, "reason": f"there is no parameter {name}"}

    def _delete_param(self, request: Request) -> dict[str, Any]:
        name = _parameter_name(request)
        self._size_bytes -= self._stored_bytes(name)
        self._values.pop(name, None)
        return DONE

    def _search_param(self, request: Request) -> dict[str, Any]:
        """Return the name itself if it exists: there are no namespaces to search upwards."""
        name = _parameter_name(request)
        return {"global_name": name if name in self._values else ""}

    def _stored_bytes(self, name: str) -> int:
        return _size_bytes(name, self._values[name]) if name in self._values else 0


def _parameter_name(request: Request) -> str:
    name: str = request.values["name"]
    # ROS 2 has parameters of nodes, `<node>:<name>`; a node's slash may be left out (rosapi/params.py).
    return f"/{name}" if ":" in name and not name.startswith("/") else name


def _type_answer(names: TypedNames, field: str) -> Handler:
    return lambda request: {"type": names.type_of(request.name(field), request.dialect) or ""}


@functools.lru_cache(MAX_NODE_NAMES)
def node_name(name: str) -> str:
    return "/" + re.sub(r"\W+", "_", name).strip("_")


def _node_names(nodes: Iterable[Node]) -> list[str]:
    return sorted({node_name(node.name) for node in nodes})


def _shown(names: Iterable[str]) -> list[str]:
    return sorted(name for name in names if not is_hidden(name))


def _joined(lists: Iterable[list[str]]) -> list[str]:
    return list(dict.fromkeys(itertools.chain.from_iterable(lists)))


def _responder(handler: Handler) -> Callable[[Call], None]:
    def respond(call: Call) -> None:
        with failure_answered(call):
            call.succeed(CompleteResponse(handler(Request(call.request, call.dialect))))

    return respond


def _limited(texts: list[str]) -> list[str]:
    """Replace texts from the one on that exceeds `MAX_TEXTS_CHARACTERS` in all by empty ones."""
    kept = bisect_right(list(itertools.accumulate(map(len, texts))), MAX_TEXTS_CHARACTERS)
    return texts[:kept] + [""] * (len(texts) - kept)


def _as_json(text: str) -> str:
    try:
        json.loads(text)
    # Text that nests too deep exceeds the parser's recursion limit.
    except (ValueError, RecursionError):
        return json.dumps(text)
    return text


def _size_bytes(name: str, value: str) -> int:
    return len(name.encode()) + len(value.encode())
