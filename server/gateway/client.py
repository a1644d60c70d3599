"""One client as a node of the graph: carries its operations out, queues what it gets; without any socket."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

from protocol.dialect import Dialect
from protocol.errors import ProtocolError
from protocol.limits import Limits
from protocol.operations import CallService, Operation, Publish, SendActionGoal
from protocol.publication import Parcel
from protocol.session import Refusal, Session
from server.access.access import unlimited
from server.access.roles import ANYONE, Identity
from server.errors import GraphError
from server.gateway.client_actions import ClientActions
from server.gateway.client_auth import ClientAuth, WayIn
from server.gateway.client_services import ClientServices
from server.gateway.client_status import ClientStatus
from server.gateway.client_topics import ClientTopics
from server.gateway.spelling import Spelling
from server.graph.node import Node
from server.graph.topics import Graph

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
        identity: who it is; None for one that has yet to say so.
        way_in: the way in, where that is guarded.

    Attributes:
        received_messages: how many frames have come.
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
        identity: Identity | None = ANYONE,
        way_in: WayIn | None = None,
    ) -> None:
        self.node = Node(name, remote=True, identity=identity)
        way_in = way_in or WayIn(unlimited())
        self._guard = way_in.access.guard(self.node)
        self.session = Session(limits, dialect)
        self.received_messages = 0
        self._graph = graph
        self._clock = clock
        self._wake = wake
        spelling = Spelling(self.session, graph.interfaces.registry)
        status = self._status = ClientStatus(self.node, self.session, wake)
        self._topics = ClientTopics(
            self.node, self.session, graph, spelling, clock, wake, status.refuse_error, send_at_once
        )
        self._services = ClientServices(self.node, graph.services, spelling, limits, self._send, self._ask, status.tell)
        self._actions = ClientActions(
            self.node, graph.actions, spelling, limits, self._send, self._ask, self._send_feedback, status.tell
        )
        self._auth = ClientAuth(self.node, self._guard, way_in, status.tell)

    # Tables are made when a client says something for the first time: many only wait.

    @cached_property
    def _handlers(self) -> Mapping[type[Operation], Callable[..., None]]:
        return {
            **self._auth.handlers,
            **self._topics.handlers,
            **self._services.handlers,
            **self._actions.handlers,
            **self._status.handlers,
        }

    @cached_property
    def _failures(self) -> Mapping[str | None, Callable[[str | int | None, str], None]]:
        return {"service_response": self._services.fail, "action_result": self._actions.fail}

    @cached_property
    def _turned_away(self) -> Mapping[type[Operation], Callable[..., None]]:
        return {
            Publish: self._topics.turn_away,
            CallService: self._services.turn_away,
            SendActionGoal: self._actions.turn_away,
        }

    def receive_frame(self, frame: str | bytes) -> None:
        """Carry out what a frame asks for; nothing in it can raise."""
        self.received_messages += 1
        # Before a client has said who it is, nothing else is heard of it.
        if self.node.identity is None and not self._auth.may_be_heard(frame):
            return
        items = self.session.receive_frame(frame, self._clock())
        if self.node.identity is None and not self._auth.may_be_first(items):
            return
        for item in items:
            if isinstance(item, Refusal):
                self._refuse(item)
            else:
                self._carry_out(item)
            if self.node.identity is None:
                return

    @property
    def refused_operations(self) -> int:
        """How many operations were not carried out."""
        return self._status.refused

    def leave(self) -> None:
        """Take the client out of the graph."""
        self._guard.leave()
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
            refusal = self._guard.refusal(operation)
            if refusal is not None:
                self._turn_away(operation, refusal)
                return
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

    def _turn_away(self, operation: Operation, reason: str) -> None:
        """Say that the client may not do something; who waits for an answer to it gets one."""
        self._status.turn_away(operation, reason)
        answer = self._turned_away.get(type(operation))
        if answer is not None:
            answer(operation, reason)

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
