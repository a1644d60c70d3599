"""``POST /goal``: one goal in, its one answer out, for curl, shells and PLCs.

A request is a client of its own, which connects, sends one goal and leaves. Roles, control lease, queue, confirmation
and stops hold for it as for clients over WebSocket.
"""

import asyncio
import logging
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from http import HTTPStatus
from typing import Any

import orjson

from protocol.errors import OperationError, describe, one_line, shorten
from protocol.operations import CallService, SendActionGoal
from robot.stop_epochs import STOP_EPOCHS
from server.access.authorization import Access, Authorizer, rule_of_action, rule_of_service
from server.arrival import arrived_in, epoch_after
from server.gateway.admission import wrong_choice
from server.gateway.connection import goals_end_with_client
from server.gateway.http import HttpResponse, PostedRequest
from server.graph.actions import GoalStatus, Result
from server.graph.permissions import Node, display_name
from server.graph.services import MAX_TIMEOUT_S, Response
from server.graph.topics import Graph

log = logging.getLogger("armbridge.gateway")

PATH = "goal"

GOAL_SERVICE, STOP_SERVICE = "/moveit_goal", "/arm/stop"
GRIPPER_ACTION, GRIPPER_TYPE = "/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand"

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
        answered: asyncio.Future[Response | Result] = asyncio.get_running_loop().create_future()

        def take_end(end: Response | Result) -> None:
            # The goal of a client that has left may end later.
            if not answered.done():
                answered.set_result(end)

        try:
            operation = self._read(posted.body)
            # A stop is carried out whatever its query is.
            timeout_s = DEFAULT_TIMEOUT_S if operation.args is None else _read_query(posted.query)
            with arrived_in(epoch_after(operation.after_stop, posted.epoch)):
                self._send(operation, node, authorizer, take_end)
            # The sender of a goal knows the stops before it, the sender of a stop its own as well.
            stops = STOP_EPOCHS.present if operation.args is None else posted.epoch
            async with asyncio.timeout(timeout_s):
                status, values = _answer_of(await answered)
            return HttpResponse.of_json(status, {**values, "stops": stops})
        except _RefusedError as error:
            log.debug("%s: refused: %s", node, error)
            return HttpResponse.of_failure(error.status, str(error))
        except OperationError as error:
            return HttpResponse.of_failure(HTTPStatus.BAD_REQUEST, str(error))
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
        take_end: Callable[[Response | Result], None],
    ) -> None:
        graph = self._graph
        if isinstance(operation, CallService):
            name = operation.service
            denied = authorizer.name_refusal(rule_of_service(name, graph), "service", name)
        else:
            name = operation.action
            denied = authorizer.name_refusal(rule_of_action(name, graph), "action", name)
        if denied is not None:
            raise _RefusedError(denied, HTTPStatus.FORBIDDEN)
        refusal = authorizer.refusal(operation)
        if refusal is not None:
            raise _RefusedError(refusal, HTTPStatus.CONFLICT)
        if isinstance(operation, CallService):
            graph.services.call(node, name, operation.args, take_end, MAX_TIMEOUT_S)
        else:
            graph.actions.send_goal(node, name, GRIPPER_TYPE, operation.args, take_end)

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
        prefix, after_stop = f"/{arm}" if arm else "", request.pop("after_stop", None)
        if request.get("stop"):
            # Somebody wants the arm to stop, whatever else the request says.
            return CallService(service=f"{prefix}{STOP_SERVICE}")
        if "gripper" not in request:
            return CallService(service=f"{prefix}{GOAL_SERVICE}", args=request, after_stop=after_stop)
        command = request.pop("gripper")
        if request or not isinstance(command, dict) or "position" not in command:
            beside = f" beside {one_line(shorten(', '.join(request)))}" if request else ""
            sentence = f"field gripper: must be an object with position, by itself, not {describe(command)}{beside}"
            raise _RefusedError(sentence)
        return SendActionGoal(
            action=f"{prefix}{GRIPPER_ACTION}",
            action_type=GRIPPER_TYPE,
            args={"command": command},
            after_stop=after_stop,
        )


def _read_query(query: Mapping[str, Sequence[str]]) -> float:
    """Check the choices of a query, and return its timeout [s]."""
    if wrong := wrong_choice(query):
        raise _RefusedError(wrong)
    text = query.get("timeout", [str(DEFAULT_TIMEOUT_S)])[-1]
    try:
        timeout_s = float(text)
    except ValueError:
        timeout_s = math.nan
    if not 0.0 < timeout_s <= MAX_TIMEOUT_S:
        raise _RefusedError(f"timeout must be above 0 and at most {MAX_TIMEOUT_S:g} s, not {one_line(shorten(text))!r}")
    return timeout_s


def _answer_of(end: Response | Result) -> tuple[HTTPStatus, Mapping[str, Any]]:
    """Return status and fields of the answer to the end of a call, or of a gripper's goal."""
    values = end.values
    if not end.ok:
        return _UNPROCESSABLE, {"success": False, "message": str(values)}
    if isinstance(end, Response):
        failed = _STATUSES.get(values.get("code_name", "CONTROL_FAILED"), _UNPROCESSABLE)
        return HTTPStatus.OK if values["success"] else failed, values
    succeeded = end.status == GoalStatus.SUCCEEDED
    if succeeded:
        sentence = "the gripper holds an object" if values["stalled"] else "the gripper is there"
    else:
        sentence = "the goal of the gripper was cancelled, by a stop, another client or another goal"
    status = HTTPStatus.OK if succeeded else HTTPStatus.CONFLICT
    return status, {"success": succeeded, "message": sentence, **values}
