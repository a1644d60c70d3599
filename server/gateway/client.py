"""One client as a node of the graph: carries its operations out, queues what it gets; without any socket."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

from protocol.dialect import Dialect
from protocol.errors import OperationError, ProtocolError, shorten
from protocol.limits import Limits
from protocol.operations import Operation, SetLevel, Status
from protocol.parcel import Parcel
from protocol.session import Refusal, Session
from server.errors import GraphError
from server.gateway.client_actions import ClientActions
from server.gateway.client_services import ClientServices
from server.gateway.client_topics import ClientTopics
from server.gateway.spelling import Spelling
from server.graph import Graph
from server.node import Node

log = logging.getLogger("armbridge.gateway")

_LOG_LEVELS = {"none": logging.DEBUG, "error": logging.ERROR, "warning": logging.WARNING, "info": logging.INFO}


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
        topics = ClientTopics(self.node, self.session, graph, spelling, clock, wake, self._refuse_error, send_at_once)
        services = ClientServices(self.node, graph.services, spelling, limits, self._send)
        actions = ClientActions(self.node, graph.actions, spelling, limits, self._send, self._send_feedback)
        self._handlers: Mapping[type[Operation], Callable[..., None]] = {
            **topics.handlers,
            **services.handlers,
            **actions.handlers,
            SetLevel: self._set_level,
            Status: self._log_status,
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

    def _carry_out(self, operation: Operation) -> None:
        try:
            self._handlers[type(operation)](operation)
        except (ProtocolError, GraphError) as error:
            self._refuse_error(operation.op, error, operation.id)
        except Exception:  # a bug in serving one operation must not take the client with it
            log.exception("%s: %s failed", self.node, operation.op)

    def _refuse_error(self, op: str, error: ProtocolError | GraphError, mark: str | int | None = None) -> None:
        # An OperationError names the operation itself.
        text = str(error) if isinstance(error, OperationError) else f"{op}: {error}"
        self._refuse(Refusal(op, mark, text))

    def _refuse(self, refusal: Refusal) -> None:
        log.warning("%s: refused: %s", self.node, refusal.text)
        self.session.status("error", refusal.text, refusal.id)
        self._wake()

    def _set_level(self, operation: SetLevel) -> None:
        self.session.status_level = operation.level

    def _log_status(self, operation: Status) -> None:
        log.log(_LOG_LEVELS[operation.level], "%s says: %s", self.node, shorten(operation.msg))

    def _send(self, fields: dict[str, Any]) -> None:
        self.session.reply(fields)
        self._wake()

    def _send_feedback(self, fields: dict[str, Any]) -> None:
        self.session.feedback(fields)
        self._wake()
