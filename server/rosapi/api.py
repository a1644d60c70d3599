"""Offers rosapi's services: each subject has a module, which answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from protocol.dialect import Dialect
from protocol.messages import Stamp
from protocol.registry import Registry
from server.access.permissions import NameFilter
from server.graph.actions import Actions
from server.graph.node import Node
from server.graph.services import LOCAL_TIMEOUT_S, Call, Services, answer
from server.graph.topics import Graph
from server.rosapi.parameters import Parameters
from server.rosapi.participants import Nodes, Offered, Topics
from server.rosapi.question import Answer, Answers, Question
from server.rosapi.types import Types

NODE = Node("rosapi")

# What a client is told to speak to, by its dialect. Clients look releases up in lists of their own; these are in all.
ROS_VERSIONS: Mapping[Dialect, dict[str, Any]] = {
    "ros2": {"version": 2, "distro": "jazzy"},
    "ros1": {"version": 1, "distro": "noetic"},
}


class RosApi:
    """Answers questions about the graph.

    Args:
        graph: topics.
        services: services, and where these are offered.
        actions: actions.
        registry: types.
        wall_clock: seconds since the epoch.
        params: which parameters clients may use; None for all.

    Attributes:
        parameters: what clients keep here, and the server for them.
    """

    def __init__(
        self,
        graph: Graph,
        services: Services,
        actions: Actions,
        registry: Registry,
        wall_clock: Callable[[], float],
        params: NameFilter | None = None,
    ) -> None:
        self.parameters = Parameters(params)
        self._services = services
        self._wall_clock = wall_clock
        self._answers: Answers = {
            **Topics(graph).answers,
            **Offered(services, actions).answers,
            **Nodes(graph, services).answers,
            **Types(graph, registry).answers,
            **self.parameters.answers,
            "get_time": ("rosapi_msgs/srv/GetTime", self._time),
            "get_ros_version": ("rosapi_msgs/srv/GetROSVersion", self._version),
        }

    def open(self) -> None:
        """Offer every service."""
        for name, (type_name, function) in self._answers.items():
            self._services.offer_calls(NODE, f"/rosapi/{name}", type_name, _starter(function), LOCAL_TIMEOUT_S)

    def _time(self, _asked: Question) -> dict[str, Any]:
        return {"time": Stamp.from_seconds(self._wall_clock()).as_message()}

    def _version(self, asked: Question) -> dict[str, Any]:
        return ROS_VERSIONS[asked.dialect]


def _starter(function: Answer) -> Callable[[Call], None]:
    return lambda call: answer(call, lambda request: function(Question(request, call.dialect)))
