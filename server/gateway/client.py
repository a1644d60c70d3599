"""One client as a node of the graph: carries its operations out, queues what it gets; without any socket."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

from protocol.dialect import Dialect
from protocol.errors import ProtocolError
from protocol.limits import Limits
from protocol.operations import Operation
from protocol.parcel import Parcel
from protocol.session import Refusal, Session
from server.errors import GraphError
from server.gateway.client_actions import ClientActions
from server.gateway.client_services import ClientServices
from server.gateway.client_status import ClientStatus
from server.gateway.client_topics import ClientTopics
from server.gateway.spelling import Spelling
from server.graph import Graph
from server.node import Node

log = logging.getLogger("armbridge.gateway")


class Client:
    """A rosbridge client.

    Args:
        name: how logs call it.
        graph: what it takes part in.
        limits: what it may cost.
        clock: monotonic time [s].
        wake: called when there is something to send.
        dialect: how it spells messages, until it shows otherwise.
        send_at_once: sends a message if the socket takes it without waiting, and says whether it has.
    """

    def __init__(
        self,
        name: str,
        graph: Graph,
        limits: Limits,
        clock: Callable[[], float],
        wake: Callable[[], None],
        dialect: Dialect = "ros2",
        send_at_once: Callable[[Parcel], bool] = lambda _parcel: False,
    ) -> None:
        self.node = Node(name, remote=True)
        self.session = Session(limits, dialect)
        self._graph = graph
        self._clock = clock
        self._wake = wake
        spelling = Spelling(self.session, graph.interfaces.registry)
        status = self._status = ClientStatus(self.node, self.session, wake)
        topics = ClientTopics(self.node, self.session, graph, spelling, clock, wake, status.refuse_error, send_at_once)
        services = ClientServices(self.node, graph.services, spelling, limits, self._send, self._ask, status.tell)
        actions = ClientActions(
            self.node, graph.actions, spelling, limits, self._send, self._ask, self._send_feedback, status.tell
        )
        self._handlers: Mapping[type[Operation], Callable[..., None]] = {
            **topics.handlers,
            **services.handlers,
            **actions.handlers,
            **status.handlers,
        }
        self._failures: Mapping[str | None, Callable[[str | int | None, str], None]] = {
            "service_response": services.fail,
            "action_result": actions.fail,
        }

    def receive_frame(self, frame: str | bytes) -> None:
        """Carry out what a frame asks for; nothing in it can raise."""
        for item in self.session.receive_frame(frame, self._clock()):
            if isinstance(item, Refusal):
                self._refuse(item)
            else:
                self._carry_out(item)

    def leave(self) -> None:
        """Take the client out of the graph."""
        self._graph.remove(self.node)
        if self.session.dropped:
            log.warning("%s: %d messages were dropped because it read too slowly", self.node, self.session.dropped)

    def _refuse(self, refusal: Refusal) -> None:
        self._status.refuse(refusal)
        # Somebody waits for what cannot be read.
        fail = self._failures.get(refusal.op)
        if fail is not None:
            fail(refusal.id, refusal.text)

    def _carry_out(self, operation: Operation) -> None:
        spoken = self.session.dialect
        try:
            self._handlers[type(operation)](operation)
        except (ProtocolError, GraphError) as error:
            self._status.refuse_error(operation.op, error, operation.id)
        except Exception:  # a bug in serving one operation must not take the client with it
            log.exception("%s: %s failed", self.node, operation.op)
        else:
            self._status.acknowledge(operation)
        if self.session.dialect != spoken:
            self._status.tell(
                "info", operation, "its type exists only in ROS 1, whose spelling this client gets from now on"
            )

    def _send(self, fields: dict[str, Any]) -> None:
        self.session.reply(fields)
        self._wake()

    def _ask(self, fields: dict[str, Any]) -> bool:
        room = self.session.ask(fields)
        self._wake()
        return room

    def _send_feedback(self, fields: dict[str, Any]) -> None:
        self.session.feedback(fields)
        self._wake()
