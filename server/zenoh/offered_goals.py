"""Goals of other machines to this server's actions: the services ``send_goal`` and ``get_result`` of each action.

rcl makes an action of three services and two topics (rcl_action, action_server.c). The graph itself has the third
service, ``cancel_goal``, and the topics ``status`` and ``feedback``; they are shared as any others.
"""

from __future__ import annotations

import asyncio
from base64 import b64decode
from collections.abc import Callable
from typing import Any, TypeAlias

from protocol.errors import MessageError
from protocol.operations import SendActionGoal
from server.access.authorization import Authorizer
from server.arrival import arrived_in
from server.graph.action_topics import ENDED_KEPT_S
from server.graph.actions import GoalStatus, Result
from server.graph.message_types import ReceivedMessage
from server.graph.services import Response
from server.zenoh.network import Network

# Ending of the service's name -> ending of its type.
GOAL_SERVICES = {"send_goal": "_SendGoal", "get_result": "_GetResult"}

# Goals of all other machines whose results are kept; far more than an arm carries out.
MAX_GOALS = 1_000

Respond: TypeAlias = Callable[[Response], None]


class OfferedGoals:
    """Goals that other machines have sent, until their results have been kept long enough."""

    def __init__(self, network: Network, authorizer: Authorizer) -> None:
        self._network = network
        self._authorizer = authorizer
        self._results: dict[str, asyncio.Future[Result]] = {}

    def send(self, action: str, octets: bytes, epoch: int, respond: Respond) -> None:
        """Serve ``send_goal``, a request as CDR that arrived in a stop epoch."""
        network, type_name = self._network, self._network.graph.actions.type_of(action)
        if type_name is None:
            respond(_no_action(action))
            return

        def take(request: dict[str, Any] | MessageError) -> None:
            if isinstance(request, MessageError):
                refusal: str | None = str(request)
            else:
                with arrived_in(epoch):
                    refusal = self._start(action, type_name, request["goal_id"]["uuid"], request["goal"])
            if refusal is not None:
                network.warn(f"a goal of another machine to {action} is rejected: {refusal}")
            stamp = network.graph.message_types.now().as_message()
            respond(Response(ok=True, values={"accepted": refusal is None, "stamp": stamp}))

        network.decode_member(f"{type_name}_SendGoal_Request", "goal", octets, take)

    def _start(self, action: str, type_name: str, goal_id: str, goal: ReceivedMessage) -> str | None:
        """Send a goal to its action; return the reason if it is not taken on."""
        network = self._network
        if len(self._results) >= MAX_GOALS:
            return f"{MAX_GOALS} goals of other machines are known already"
        if goal_id in self._results:
            return "another goal has its id"
        refusal = self._authorizer.refusal(SendActionGoal(action=action, action_type=type_name, args=goal.value))
        if refusal is not None:
            return refusal
        result: asyncio.Future[Result] = network.loop.create_future()
        network.graph.actions.send_goal(
            network.node, action, type_name, goal, result.set_result, goal_id=b64decode(goal_id)
        )
        if result.done() and result.result().status == GoalStatus.UNKNOWN:
            return str(result.result().values)
        self._results[goal_id] = result
        result.add_done_callback(lambda _: network.loop.call_later(ENDED_KEPT_S, self._results.pop, goal_id, None))
        return None

    def get_result(self, action: str, octets: bytes, respond: Respond) -> None:
        """Serve ``get_result``: respond when the goal has ended; at once, with an unknown status, for no known goal."""
        network, type_name = self._network, self._network.graph.actions.type_of(action)
        if type_name is None:
            respond(_no_action(action))
            return

        def answer(result: Result) -> None:
            values = result.values if result.ok else network.graph.message_types.complete(f"{type_name}_Result", {})
            respond(Response(ok=True, values={"status": int(result.status), "result": values}))

        def take(request: dict[str, Any] | MessageError) -> None:
            known = None if isinstance(request, MessageError) else self._results.get(request["goal_id"].value["uuid"])
            if known is None:
                answer(Result(ok=False, status=GoalStatus.UNKNOWN, values=""))
            else:
                known.add_done_callback(lambda done: answer(done.result()))

        network.decode_member(f"{type_name}_GetResult_Request", "goal_id", octets, take)


def _no_action(action: str) -> Response:
    return Response(ok=False, values=f"Action {action} does not exist")
