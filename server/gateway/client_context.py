"""Context that the parts of one client share, with its status messages and the translation of all others.

The levels of status messages are rosbridge's (section 3.2, status): an error is not carried out, a
warning is carried out but was most likely not meant so, info confirms a success.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from protocol import dialect
from protocol import operations as ops
from protocol.codecs import cbor
from protocol.codecs.pieces import encoding_cost_bytes
from protocol.errors import NothingToDoError, OperationError, ProtocolError, describe, one_line, shorten
from protocol.limits import Limits
from protocol.operations import Operation, OperationId
from protocol.publication import LARGE_BYTES
from protocol.send_queue import SendBudget
from protocol.session import LaterFields, Refusal, Session
from robot.logs import LogLimiter
from server.access.authentication import AuthThrottle
from server.access.authorization import Access
from server.errors import GraphError
from server.gateway.turns import Turns
from server.graph.permissions import Node
from server.graph.topics import Graph

if TYPE_CHECKING:
    from server.gateway.connection import Connection
    from server.gateway.transport import Transport

log = logging.getLogger("armbridge.gateway")

# Values in the lists of messages of a client's calls that wait, and as many of its goals: 75 MB. The last one may go
# beyond.
MAX_VALUES_IN_FLIGHT = 500_000

# Log lines about one client: at once, and in the long run [1/s].
LOG_BURST = 50
LOG_LINES_PER_S = 1.0

# Errors that a client gets without having asked for them, until one of its operations is carried out: some clients log
# a traceback for every status message.
MAX_UNASKED_ERRORS = 10

_LOG_LEVELS = {"none": logging.DEBUG, "error": logging.ERROR, "warning": logging.WARNING, "info": logging.INFO}


# Field with the name, and words of success, of operations without an answer in rosbridge; publish has no
# acknowledgement, for it would come with every message.
_DONE: Mapping[type[Operation], tuple[str, str]] = {
    ops.Advertise: ("topic", "advertised"),
    ops.Unadvertise: ("topic", "no longer advertised under this id"),
    ops.Subscribe: ("topic", "subscribed"),
    ops.Unsubscribe: ("topic", "no longer subscribed under this id"),
    ops.AdvertiseService: ("service", "offered"),
    ops.UnadvertiseService: ("service", "withdrawn"),
    ops.AdvertiseAction: ("action", "offered"),
    ops.UnadvertiseAction: ("action", "withdrawn"),
}


class ClientStatus:
    """Status messages of one client, as it wants them by ``set_level``, and log lines about it.

    Until its first operation is carried out, a client gets unasked errors about frames without an operation and about
    unknown topics: someone who types JSON by hand would wait for an answer in vain.
    """

    def __init__(self, context: ClientContext) -> None:
        self._context = context
        self._node = context.node
        self._session = context.session
        self._last_rejection = ""
        self._unasked_errors_left = MAX_UNASKED_ERRORS
        self._log_limiter = LogLimiter(LOG_BURST, LOG_LINES_PER_S)

    def refuse(self, refusal: Refusal) -> None:
        unasked = refusal.op is None
        self._refuse(refusal, unasked=unasked, always=unasked and "stop" in refusal.text.lower())

    def refuse_misspelt_stop(self, text: str, id_: OperationId) -> None:
        """Report a message that stops nothing: a person who means to stop the arm must not wait in vain."""
        self._refuse(Refusal("publish", id_, text), unasked=True, always=True)

    def _refuse(self, refusal: Refusal, *, unasked: bool, always: bool = False) -> None:
        text = one_line(refusal.text)
        self._log(logging.WARNING, f"{self._node}: refused: {text}")
        unasked = unasked and self._unasked_errors_left > 0
        self._unasked_errors_left -= unasked
        self._session.status("error", text, refusal.id, unasked=unasked or always)
        self._context.wake()

    def reject(self, operation: Operation, reason: str) -> None:
        """Report an operation that the client may not do; the same one again is not logged: it may come fast."""
        text = one_line(f"{operation.op}: {reason}")
        if text != self._last_rejection:
            self._log(logging.WARNING, f"{self._node}: refused: {text}")
        self._last_rejection = text
        self._session.status("error", text, operation.id)
        self._context.wake()

    def refuse_error(self, op: str, error: ProtocolError | GraphError, id_: OperationId = None) -> None:
        # An OperationError names the operation itself.
        text = str(error) if isinstance(error, OperationError) else f"{op}: {error}"
        if isinstance(error, NothingToDoError):
            self._session.status("warning", text, id_)
            self._context.wake()
        else:
            self._refuse(Refusal(op, id_, text), unasked=isinstance(error, GraphError))

    def report(self, level: Literal["error", "warning", "info"], operation: Operation, text: str) -> None:
        """Report on an operation that is carried out, or an error that is logged elsewhere."""
        if self._session.status_level == "none":
            return
        self._session.status(level, f"{operation.op}: {text}", operation.id)
        self._context.wake()

    @property
    def gets_hints(self) -> bool:
        """True when the client has asked for status messages, or has had nothing carried out yet."""
        return self._unasked_errors_left > 0 or self._session.status_level != "none"

    def hint(self, operation: Operation, text: str) -> None:
        """Warn of an operation that is carried out, but has most likely a slip."""
        self._session.status("warning", f"{operation.op}: {text}", operation.id, unasked=self._unasked_errors_left > 0)
        self._context.wake()

    def acknowledge(self, operation: Operation) -> None:
        """Confirm an operation that has no answer of its own."""
        # A client that has shown a token may still spell all other operations wrongly.
        if self._unasked_errors_left and not isinstance(operation, ops.Auth):
            self._unasked_errors_left = 0
        if self._session.status_level == "none" or (done := _DONE.get(type(operation))) is None:
            return
        field, words = done
        self.report("info", operation, f"{field} {getattr(operation, field)}: {words}")
        if isinstance(operation, ops.Advertise | ops.Subscribe) and operation.qos:
            self.report("warning", operation, "field qos: has no effect")
        if isinstance(operation, ops.Subscribe) and operation.compression != operation.encoding:
            unknown = f"wanted none, png, cbor or cbor-raw, got {describe(operation.compression)}"
            self.report("warning", operation, f"field compression: {unknown}; messages come as with none")

    def set_level(self, operation: ops.SetLevel) -> None:
        self._unasked_errors_left = 0
        self._session.status_level = operation.level

    def log_status(self, operation: ops.Status) -> None:
        self._log(_LOG_LEVELS[operation.level], f"{self._node} says: {one_line(shorten(operation.msg))}")

    def _log(self, level: int, line: str) -> None:
        self._log_limiter.write(log, level, line, "client", self._context.clock(), extra={"client": str(self._node)})


@dataclass(frozen=True, eq=False)
class Gateway:
    """Parts that all clients of a listener share; ``cancels_goals`` ends the goals of a client that leaves."""

    graph: Graph
    access: Access
    throttle: AuthThrottle
    turns: Turns
    budget: SendBudget = field(default_factory=SendBudget)
    limits: Limits = field(default_factory=Limits)
    ros_version: int = 2
    cancels_goals: bool = False


class ClientContext:
    """Parts of one client that its topics, services, actions and authentication share."""

    __slots__ = (
        "clock", "connection", "gateway", "graph", "left", "node", "session", "status", "transport",
    )  # fmt: skip

    def __init__(
        self, node: Node, session: Session, gateway: Gateway, transport: Transport, connection: Connection
    ) -> None:
        self.node = node
        self.session = session
        self.gateway = gateway
        self.graph = gateway.graph
        self.clock = gateway.turns.clock
        self.transport = transport
        self.connection = connection
        self.left = False
        self.status = ClientStatus(self)

    def wake(self) -> None:
        if not self.left:
            self.connection.wake()

    def to_client(self, type_name: str, msg: Mapping[str, Any]) -> Mapping[str, Any]:
        """Translate a complete message for the client, as part of a reply."""
        registry = self.graph.message_types.registry
        speaks_bson, speaks_ros1 = self.session.speaks_bson, self.session.dialect == "ros1"
        if not (speaks_bson or speaks_ros1) or not registry.knows(type_name):
            return msg
        if speaks_bson:
            msg = cbor.packed(registry, type_name, msg, numbers=False)
        return dialect.to_ros1(registry, type_name, msg) if speaks_ros1 else msg

    def send(self, fields: dict[str, Any]) -> None:
        """Send the client an operation without a message, which is never dropped."""
        if self.session.reply(fields):
            self.wake()

    def send_message(self, fields: dict[str, Any], field: str, type_name: str) -> None:
        """Send the client an operation with a message in ROS 2 spelling in ``field``, which is never dropped.

        ``type_name`` is unknown to the registry for values that are sent unchanged.
        """
        if not self.left and self.session.reply(self._translated(fields, field, type_name)):
            self.wake()

    def send_request(self, fields: dict[str, Any], type_name: str) -> bool:
        """Send the client a call or a goal with its message in ``args``; return False when there is no room for it."""
        if self.left:
            return False
        has_room = self.session.ask(self._translated(fields, "args", type_name))
        if not self.session.send_queue.empty:
            self.wake()
        return has_room

    def send_feedback(self, fields: dict[str, Any], type_name: str) -> None:
        """Send an operation with its message in ``values`` that may be dropped when the client reads too slowly."""
        if not self.left:
            self.session.feedback(self._translated(fields, "values", type_name), self.clock())
            self.wake()

    def _translated(self, fields: dict[str, Any], field: str, type_name: str) -> Mapping[str, Any] | LaterFields:
        def translated() -> Mapping[str, Any]:
            return {**fields, field: self.to_client(type_name, fields[field])}

        return translated if encoding_cost_bytes(fields[field], LARGE_BYTES) >= LARGE_BYTES else translated()
