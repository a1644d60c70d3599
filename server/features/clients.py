"""Clients of the server: the ports that they connect to, the tokens for them, and two addresses for HTTP.

``GET /armbridge/interface.json`` describes the server. ``POST /goal`` is one goal in, its one answer out, for curl,
shells and PLCs. Such a request is a client of its own, which connects, sends one goal and leaves. Roles, control lease,
queue, confirmation and stops hold for it as for clients over WebSocket.
"""

import asyncio
import functools
import hashlib
import json
import logging
import math
from collections.abc import Callable, Collection, Mapping
from http import HTTPStatus
from importlib import metadata
from typing import Any, Literal

import orjson
from websockets.http11 import Request

from protocol.errors import describe, one_line, shorten
from protocol.operations import CallService, SendActionGoal
from protocol.registry import Registry
from protocol.type_descriptions import message_hash, service_hash
from server.access.authorization import Access, Authorizer, rule_of_action, rule_of_service, rule_of_topic
from server.access.one_time_tokens import offer_one_time_tokens
from server.arrival import arrived_in
from server.features.context import ArmContext, ServerContext
from server.gateway.connection import goals_end_with_client
from server.gateway.http import HttpHandler, HttpResponse, PostedRequest, Route
from server.gateway.listener import Listener
from server.graph.actions import GoalStatus, Result
from server.graph.node import Node
from server.graph.permissions import NameFilter, Role, Rule, display_name
from server.graph.services import MAX_TIMEOUT_S, Response
from server.graph.topics import Graph
from server.lifecycle import Feature


class Clients(Feature):
    """Listener, and the service that issues tokens for it; raises ConfigurationError for a certificate of no use."""

    name = "clients"
    deadline_s = 0.6

    def __init__(self, context: ServerContext) -> None:
        self.routes: dict[str, Route] = {INTERFACE_PATH: functools.partial(interface_document, context)}
        access, stops = context.access, context.settings.goals.on_disconnect == "stop"
        names = [each.name for each in context.arms if each.name]
        goals = HttpGoals(context.graph, access, names, takes_goals_along=stops)
        self.listener = Listener(
            context.graph,
            context.settings.server,
            HttpHandler(
                context.planning.robot,
                routes=self.routes,
                post_routes={GOAL_PATH: goals.answer},
                classroom_ports=context.settings.server.classroom.values(),
            ),
            access,
            takes_goals_along=stops,
        )
        node = Node("classroom")
        context.graph.advertise(node, CLASSROOM_TOPIC, "std_msgs/String", latch=True)
        context.graph.publish(node, CLASSROOM_TOPIC, {"data": json.dumps(context.settings.server.classroom)})
        offer_one_time_tokens(
            context.graph, access.one_time_tokens, access.tokens, lambda: self.listener.page_urls_elsewhere
        )

    async def start(self) -> None:
        await self.listener.bind()

    async def stop(self) -> None:
        await self.listener.close()


# Names and ports of a classroom's servers; empty elsewhere.
CLASSROOM_TOPIC = "/armbridge/classroom"

INTERFACE_PATH = "armbridge/interface.json"

# Of the document's own form; it grows when a field changes its meaning.
FORMAT = 1


async def interface_document(context: ServerContext, _request: Request) -> HttpResponse:
    """Return the document about the server for clients, with the topics, services and actions of the moment."""
    graph, access, settings = context.graph, context.access, context.settings
    # 70 ms for the hashes of all types, the first time.
    types = await asyncio.to_thread(type_hashes, graph.message_types.registry)
    document = {
        "format": FORMAT,
        "version": metadata.version("armbridge"),
        "roles": [role.name.lower() for role in Role],
        "settings": {
            "ros_version": settings.server.ros_version,
            "control": settings.access.control,
            "on_disconnect": settings.goals.on_disconnect,
            "confirm": context.goals.confirmation.enabled,
            "confirm_timeout_s": settings.goals.confirm_timeout_s,
            "max_message_bytes": settings.server.limits.max_message_bytes,
            "max_call_s": MAX_TIMEOUT_S,
        },
        "arms": [_arm(arm) for arm in context.arms],
        "topics": _names(graph.topic_names.types(), rule_of_topic, graph, access.topics, "topic"),
        "services": _names(graph.services.names.types(), rule_of_service, graph, access.services, "service"),
        "actions": _names(graph.actions.names.types(), rule_of_action, graph, access.services, "action"),
        "types": types,
        "types_sha256": hashlib.sha256("".join(map("{0[0]}{0[1]}".format, types.items())).encode()).hexdigest(),
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


log = logging.getLogger("armbridge.gateway")

GOAL_PATH = "goal"

GOAL_SERVICE, STOP_SERVICE = "/moveit_goal", "/arm/stop"
GRIPPER_ACTION, GRIPPER_TYPE = "/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand"

# Fields of the service: the targets, exactly one required, and the options; then fields of a gripper's goal.
MOTIONS, OPTIONS = ("named", "joints", "pose"), ("group", "velocity_scaling", "acceleration_scaling", "plan_only")
TARGETS = (*MOTIONS, "gripper", "stop")
GRIPPER_FIELDS = ("position", "max_effort")

# Longer than the server waits for a confirmation, and than nearly every motion takes [s].
DEFAULT_TIMEOUT_S = 300.0

# By the name of MoveIt's error code. Every other failure is the goal's own (RFC 9110, 15.5.21).
_STATUSES = {
    "PREEMPTED": HTTPStatus.CONFLICT,
    "CONTROL_FAILED": HTTPStatus.CONFLICT,
    "FAILURE": HTTPStatus.SERVICE_UNAVAILABLE,
    "COMMUNICATION_FAILURE": HTTPStatus.SERVICE_UNAVAILABLE,
    "ROBOT_STATE_STALE": HTTPStatus.SERVICE_UNAVAILABLE,
    "CRASH": HTTPStatus.SERVICE_UNAVAILABLE,
}
_UNPROCESSABLE = HTTPStatus.UNPROCESSABLE_ENTITY


class _RefusedError(Exception):
    def __init__(self, sentence: str, status: HTTPStatus = HTTPStatus.BAD_REQUEST) -> None:
        super().__init__(sentence)
        self.status = status


class HttpGoals:
    """Goals that are posted to ``/goal``; the field ``arm`` chooses one of several arms."""

    def __init__(self, graph: Graph, access: Access, arms: Collection[str], *, takes_goals_along: bool) -> None:
        self._graph = graph
        self._access = access
        self._arms = arms
        self._takes_goals_along = takes_goals_along

    async def answer(self, posted: PostedRequest) -> HttpResponse:
        node = Node(
            display_name(posted.identity, posted.address),
            remote=True,
            takes_goals_along=goals_end_with_client(posted.query, unless_asked=self._takes_goals_along),
            identity=posted.identity,
            address=posted.address,
        )
        authorizer = Authorizer(node, self._access, self._graph)
        answered: asyncio.Future[HttpResponse] = asyncio.get_running_loop().create_future()

        def answer(response: HttpResponse) -> None:
            # The goal of a client that has left may end later.
            if not answered.done():
                answered.set_result(response)

        try:
            timeout_s, operation = _timeout_s(posted), self._read(posted.body)
            with arrived_in(posted.epoch):
                self._send(operation, node, authorizer, answer)
            async with asyncio.timeout(timeout_s):
                return await answered
        except _RefusedError as error:
            log.debug("%s: refused: %s", node, error)
            return HttpResponse.of_failure(error.status, str(error))
        except TimeoutError:
            node.takes_goals_along = True
            sentence = f"the goal did not end within {timeout_s:g} s (?timeout=), so it is cancelled"
            return HttpResponse.of_failure(HTTPStatus.GATEWAY_TIMEOUT, sentence)
        finally:
            authorizer.leave()
            self._graph.remove(node)

    def _send(
        self,
        operation: CallService | SendActionGoal,
        node: Node,
        authorizer: Authorizer,
        answer: Callable[[HttpResponse], None],
    ) -> None:
        if isinstance(operation, CallService):
            name = operation.service
            self._check(authorizer, operation, rule_of_service(name, self._graph), "service", name)
            services, end = self._graph.services, lambda response: answer(_of_response(response))
            services.call(node, name, operation.args, end, MAX_TIMEOUT_S)
        else:
            name = operation.action
            self._check(authorizer, operation, rule_of_action(name, self._graph), "action", name)
            actions = self._graph.actions
            actions.send_goal(node, name, GRIPPER_TYPE, operation.args, lambda result: answer(_of_result(result)))

    def _check(
        self,
        authorizer: Authorizer,
        operation: CallService | SendActionGoal,
        rule: Rule,
        kind: Literal["service", "action"],
        name: str,
    ) -> None:
        denied = authorizer.name_refusal(rule, kind, name)
        if denied is not None:
            raise _RefusedError(denied, HTTPStatus.FORBIDDEN)
        refusal = authorizer.refusal(operation)
        if refusal is not None:
            raise _RefusedError(refusal, HTTPStatus.CONFLICT)

    def _read(self, body: bytes) -> CallService | SendActionGoal:
        try:
            request = orjson.loads(body)
        except orjson.JSONDecodeError as error:
            raise _RefusedError(f"the body is no JSON: {one_line(shorten(str(error)))}") from None
        if not isinstance(request, dict):
            raise _RefusedError(f"the body must be a JSON object, not {describe(request)}")
        arm = request.pop("arm", "")
        if not isinstance(arm, str) or arm not in ("", *self._arms):
            known = ", ".join(self._arms) or "none, this server has one arm"
            raise _RefusedError(f"field arm: {describe(arm)} is unknown; known: {known}")
        prefix = f"/{arm}" if arm else ""
        given = [name for name in TARGETS if name in request]
        if len(given) != 1:
            got = " and ".join(given) or "none"
            raise _RefusedError(f"exactly one of {', '.join(TARGETS)} must be given, not {got}")
        if given == ["stop"]:
            _check_fields(request, ("stop",), "")
            if request["stop"] is not True:
                raise _RefusedError(f"field stop: must be true, not {describe(request['stop'])}")
            return CallService(service=f"{prefix}{STOP_SERVICE}", args={})
        if given == ["gripper"]:
            _check_fields(request, ("gripper",), "")
            command = request["gripper"]
            if not isinstance(command, dict) or "position" not in command:
                raise _RefusedError(f"field gripper: must be an object with position, not {describe(command)}")
            _check_fields(command, GRIPPER_FIELDS, "gripper.")
            return SendActionGoal(
                action=f"{prefix}{GRIPPER_ACTION}", action_type=GRIPPER_TYPE, args={"command": command}
            )
        _check_fields(request, (*MOTIONS, *OPTIONS), "")
        return CallService(service=f"{prefix}{GOAL_SERVICE}", args=request)


def _check_fields(given: Mapping[str, Any], known: Collection[str], place: str) -> None:
    unknown = next((name for name in given if name not in known), None)
    if unknown is not None:
        shown = one_line(shorten(f"{place}{unknown}"))
        raise _RefusedError(f"field {shown}: unknown here; known: {', '.join(known)}")


def _timeout_s(posted: PostedRequest) -> float:
    text = posted.query.get("timeout", [str(DEFAULT_TIMEOUT_S)])[-1]
    try:
        timeout_s = float(text)
    except ValueError:
        timeout_s = math.nan
    if not 0.0 < timeout_s <= MAX_TIMEOUT_S:
        raise _RefusedError(f"timeout must be above 0 and at most {MAX_TIMEOUT_S:g} s, not {one_line(shorten(text))!r}")
    return timeout_s


def _of_response(response: Response) -> HttpResponse:
    if not response.ok:
        return HttpResponse.of_failure(_UNPROCESSABLE, str(response.values))
    if response.values["success"]:
        return HttpResponse.of_json(HTTPStatus.OK, response.values)
    status = _STATUSES.get(response.values.get("code_name", "CONTROL_FAILED"), _UNPROCESSABLE)
    return HttpResponse.of_json(status, response.values)


def _of_result(result: Result) -> HttpResponse:
    if not result.ok:
        return HttpResponse.of_failure(_UNPROCESSABLE, str(result.values))
    if result.status != GoalStatus.SUCCEEDED:
        sentence = "the goal of the gripper was cancelled, by a stop, another client or another goal"
        return HttpResponse.of_json(HTTPStatus.CONFLICT, {"success": False, "message": sentence, **result.values})
    sentence = "the gripper holds an object" if result.values["stalled"] else "the gripper is there"
    return HttpResponse.of_json(HTTPStatus.OK, {"success": True, "message": sentence, **result.values})
