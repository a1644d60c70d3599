"""Clients of the server: the ports that they connect to, the tokens for them, and ``GET /armbridge/interface.json``."""

import asyncio
import functools
import hashlib
import json
from collections.abc import Callable, Mapping
from http import HTTPStatus
from importlib import metadata
from typing import Any

from websockets.http11 import Request

from protocol.registry import Registry
from protocol.type_descriptions import message_hash, service_hash
from server.access.authorization import rule_of_action, rule_of_service, rule_of_topic
from server.access.one_time_tokens import offer_one_time_tokens
from server.execution.queue import SHUTTING_DOWN
from server.features.context import ArmContext, ServerContext
from server.gateway import http_goals
from server.gateway.http import HttpHandler, HttpResponse, Route
from server.gateway.listener import Listener
from server.graph.permissions import NameFilter, Role, Rule
from server.graph.topics import Graph
from server.lifecycle import Feature


class Clients(Feature):
    """Listener, and the service that issues tokens for it; raises ConfigurationError for a certificate of no use."""

    name = "clients"
    deadline_s = 0.6

    def __init__(self, context: ServerContext) -> None:
        self._requests = context.graph.actions, context.graph.services
        self.routes: dict[str, Route] = {PATH: functools.partial(interface_document, context)}
        access, stops = context.access, context.settings.goals.on_disconnect == "stop"
        names = [each.name for each in context.arms if each.name]
        goals = http_goals.HttpGoals(context.graph, access, names, takes_goals_along=stops)
        self.listener = Listener(
            context.graph,
            context.settings.server,
            HttpHandler(
                context.planning.robot,
                routes=self.routes,
                post_routes={http_goals.PATH: goals.answer},
                classroom_ports=context.settings.server.classroom.values(),
            ),
            access,
            takes_goals_along=stops,
        )
        node = context.graph.node("classroom")
        node.advertise(CLASSROOM_TOPIC, "std_msgs/String", latch=True)
        node.publish(CLASSROOM_TOPIC, {"data": json.dumps(context.settings.server.classroom)})
        offer_one_time_tokens(
            context.graph, access.one_time_tokens, access.tokens, lambda: self.listener.page_urls_elsewhere
        )

    async def start(self) -> None:
        await self.listener.bind()

    async def stop(self) -> None:
        """Close all connections; what has no answer by now, when the goals have ended, gets one."""
        for each in self._requests:
            each.fail_all(SHUTTING_DOWN)
        await self.listener.close()


# Names and ports of a classroom's servers; empty elsewhere.
CLASSROOM_TOPIC = "/armbridge/classroom"

PATH = "armbridge/interface.json"

# Of the document's own form; it grows when a field changes its meaning.
FORMAT = 1


async def interface_document(context: ServerContext, _request: Request) -> HttpResponse:
    """Return the document about the server for clients, with the topics, services and actions of the moment."""
    graph, access = context.graph, context.access
    # 70 ms for the hashes of all types, the first time.
    types = await asyncio.to_thread(type_hashes, graph.message_types.registry)
    document = {
        "format": FORMAT,
        "version": metadata.version("armbridge"),
        "roles": [role.name.lower() for role in Role],
        "arms": [_arm(arm) for arm in context.arms],
        "topics": _names(graph.topic_names.types(), rule_of_topic, graph, access.topics, "topic"),
        "services": _names(graph.services.names.types(), rule_of_service, graph, access.services, "service"),
        "actions": _names(graph.actions.names.types(), rule_of_action, graph, access.services, "action"),
        "types": types,
    }
    return HttpResponse.of_json(HTTPStatus.OK, document)


def type_hashes(registry: Registry) -> dict[str, str]:
    """Return the hash of every type by its name.

    Messages and services have ROS 2's (REP-2016); an action has the SHA-256 of its goal's, result's and feedback's.
    """
    return {name: _type_hash(registry, name) for name in sorted(registry.type_names())}


def _type_hash(registry: Registry, name: str) -> str:
    kind = name.split("/")[1]
    if kind == "srv":
        return service_hash(registry, name)
    if kind == "msg":
        return message_hash(registry, name)
    members = "".join(message_hash(registry, f"{name}_{member}") for member in ("Goal", "Result", "Feedback"))
    return f"sha256_{hashlib.sha256(members.encode()).hexdigest()}"


def _arm(arm: ArmContext) -> dict[str, Any]:
    robot = arm.robot
    return {
        "name": arm.name,
        "robot": robot.name,
        "group": arm.planning.problems.group("").name if not arm.name else robot.default_group,
        "groups": {group.name: list(group.joints) for group in robot.groups.values()},
        "gripper": [] if robot.gripper is None else list(robot.gripper.joints),
        "frame": robot.root_link,
        "tip": arm.parameters.end_effector_link or robot.tip_link,
    }


def _names(
    types: Mapping[str, str], rule_of: Callable[[str, Graph], Rule], graph: Graph, allowed: NameFilter, kind: str
) -> dict[str, dict[str, Any]]:
    """Return type and rule of the names that no setting hides; the rule of a topic is the rule of publishing on it."""
    rules = {name: rule_of(name, graph) for name in sorted(types)}
    return {
        name: {"type": types[name], "role": rule.role.name.lower(), "drives": rule.drives, "stops": rule.stops}
        for name, rule in rules.items()
        if rule.stops or allowed.refusal(kind, name) is None
    }
