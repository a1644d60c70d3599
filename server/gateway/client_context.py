"""Context that the parts of one client share, with its status messages and the translation of all others.

The levels of status messages are rosbridge's (section 3.2, status): an error is not carried out, a
warning is carried out but was most likely not meant so, info confirms a success.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

from protocol import dialect
from protocol.codecs import cbor
from protocol.codecs.pieces import encoding_cost_bytes
from protocol.dialect import Dialect
from protocol.errors import NothingToDoError, OperationError, ProtocolError, describe, one_line, shorten
from protocol.operations import (
    Advertise,
    AdvertiseAction,
    AdvertiseService,
    Auth,
    Mark,
    Operation,
    SetLevel,
    Status,
    Subscribe,
    Unadvertise,
    UnadvertiseAction,
    UnadvertiseService,
    Unsubscribe,
)
from protocol.publication import LARGE_BYTES
from protocol.registry import Kind, Registry
from protocol.session import LaterFields, Refusal, SendAtOnce, Session, never_at_once
from robot.logs import LogLimiter
from server.errors import GraphError
from server.graph.message_types import ReceivedMessage
from server.graph.node import Node
from server.graph.topics import Graph

log = logging.getLogger("armbridge.gateway")

# Values in the lists of messages of a client's calls that wait, and as many of its goals: 75 MB. The last one may go
# beyond.
MAX_VALUES_IN_FLIGHT = 500_000
VALUES_LIMIT = f"the limit is {MAX_VALUES_IN_FLIGHT}"

# Log lines about one client: at once, and in the long run [1/s].
LOG_BURST = 50
LOG_LINES_PER_S = 1.0

# Errors that a client gets without having asked for them, until one of its operations is carried out: some clients log
# a traceback for every status message.
MAX_UNASKED_ERRORS = 10

_LOG_LEVELS = {"none": logging.DEBUG, "error": logging.ERROR, "warning": logging.WARNING, "info": logging.INFO}

# Clients of both generations call rosapi's types so.
_ROSAPI = "rosapi/"


class _Done(NamedTuple):
    field: str
    words: str


# Operations without an answer in rosbridge; publish has no acknowledgement, for it would come with every message.
_DONE: Mapping[type[Operation], _Done] = {
    Advertise: _Done("topic", "advertised"),
    Unadvertise: _Done("topic", "no longer advertised under this id"),
    Subscribe: _Done("topic", "subscribed"),
    Unsubscribe: _Done("topic", "no longer subscribed under this id"),
    AdvertiseService: _Done("service", "offered"),
    UnadvertiseService: _Done("service", "withdrawn"),
    AdvertiseAction: _Done("action", "offered"),
    UnadvertiseAction: _Done("action", "withdrawn"),
}


class ClientStatus:
    """Status messages of one client, as it wants them by ``set_level``, and log lines about it.

    Until its first operation is carried out, a client gets unasked errors about frames without an operation and about
    unknown topics: someone who types JSON by hand would wait for an answer in vain.
    """

    def __init__(self, node: Node, session: Session, clock: Callable[[], float], wake: Callable[[], None]) -> None:
        self.refused = 0
        self._node = node
        self._session = session
        self._clock = clock
        self._wake = wake
        self._last_rejection = ""
        self._unasked_errors_left = MAX_UNASKED_ERRORS
        self._log_limiter = LogLimiter(LOG_BURST, LOG_LINES_PER_S)

    def release(self) -> None:
        """Let go of the connection of a client that has left."""
        self._wake = _do_nothing

    def refuse(self, refusal: Refusal) -> None:
        """Report an operation that is not carried out."""
        self._refuse(refusal, unasked=refusal.op is None)

    def _refuse(self, refusal: Refusal, *, unasked: bool) -> None:
        self.refused += 1
        text = one_line(refusal.text)
        self._log(logging.WARNING, f"{self._node}: refused: {text}")
        unasked = unasked and self._unasked_errors_left > 0
        self._unasked_errors_left -= unasked
        self._session.status("error", text, refusal.id, unasked=unasked)
        self._wake()

    def reject(self, operation: Operation, reason: str) -> None:
        """Report an operation that the client may not do; repeated ones are logged once, for they may come fast."""
        self.refused += 1
        text = one_line(f"{operation.op}: {reason}")
        if text != self._last_rejection:
            self._log(logging.WARNING, f"{self._node}: refused: {text}")
        self._last_rejection = text
        self._session.status("error", text, operation.id)
        self._wake()

    def refuse_error(self, op: str, error: ProtocolError | GraphError, id_: Mark = None) -> None:
        """Report an operation that has ended with an error."""
        # An OperationError names the operation itself.
        text = str(error) if isinstance(error, OperationError) else f"{op}: {error}"
        if isinstance(error, NothingToDoError):
            self._session.status("warning", text, id_)
            self._wake()
        else:
            self._refuse(Refusal(op, id_, text), unasked=isinstance(error, GraphError))

    def tell(self, level: Literal["error", "warning", "info"], operation: Operation, text: str) -> None:
        """Report on an operation that is carried out, or an error that is logged elsewhere."""
        if self._session.status_level == "none":
            return
        self._session.status(level, f"{operation.op}: {text}", operation.id)
        self._wake()

    @property
    def hears_doubts(self) -> bool:
        """True when the client has asked for status messages, or has had nothing carried out yet."""
        return self._unasked_errors_left > 0 or self._session.status_level != "none"

    def doubt(self, operation: Operation, text: str) -> None:
        """Warn of an operation that is carried out but was most likely not meant so."""
        self._session.status("warning", f"{operation.op}: {text}", operation.id, unasked=self._unasked_errors_left > 0)
        self._wake()

    def acknowledge(self, operation: Operation) -> None:
        """Confirm an operation that has no answer of its own."""
        # Who has only shown a token has not shown yet that its other operations are right.
        if self._unasked_errors_left and not isinstance(operation, Auth):
            self._unasked_errors_left = 0
        if self._session.status_level == "none":
            return
        done = _DONE.get(type(operation))
        if done is None:
            return
        self.tell("info", operation, f"{done.field} {getattr(operation, done.field)}: {done.words}")
        if isinstance(operation, Advertise | Subscribe) and operation.qos:
            self.tell("warning", operation, "field qos: has no effect")
        if isinstance(operation, Subscribe) and operation.compression != operation.encoding:
            unknown = f"wanted none, png, cbor or cbor-raw, got {describe(operation.compression)}"
            self.tell("warning", operation, f"field compression: {unknown}; messages come as with none")

    def set_level(self, operation: SetLevel) -> None:
        """Set the least level of the status messages."""
        self._unasked_errors_left = 0
        self._session.status_level = operation.level

    def log_status(self, operation: Status) -> None:
        """Log a status message of the client."""
        self._log(_LOG_LEVELS[operation.level], f"{self._node} says: {one_line(shorten(operation.msg))}")

    def _log(self, level: int, line: str) -> None:
        self._log_limiter.write(log, level, line, "client", self._clock(), extra={"client": str(self._node)})


def _do_nothing() -> None:
    """Wake no connection."""


class MessageTranslator:
    """Translator between one client and the graph, whose messages are in the dialect of ROS 2."""

    def __init__(self, session: Session, registry: Registry) -> None:
        self._session = session
        self._registry = registry

    @property
    def dialect(self) -> Dialect:
        """Dialect of the client."""
        return self._session.dialect

    def detect_dialect(self, type_name: object, kind: Kind) -> None:
        """Set the dialect to ROS 1 when the client names a type that exists only there."""
        if (
            isinstance(type_name, str)
            and not type_name.startswith(_ROSAPI)
            and self._registry.exists_only_in_ros1(type_name, kind)
        ):
            self._session.dialect = "ros1"

    def to_client(self, type_name: str, msg: Mapping[str, Any]) -> Mapping[str, Any]:
        """Translate a complete message for the client, as part of a reply."""
        speaks_bson, speaks_ros1 = self._session.speaks_bson, self._session.dialect == "ros1"
        if not (speaks_bson or speaks_ros1) or not self._registry.knows(type_name):
            return msg
        if speaks_bson:
            msg = cbor.packed(self._registry, type_name, msg, numbers=False)
        return dialect.to_ros1(self._registry, type_name, msg) if speaks_ros1 else msg

    def from_client(self, message: ReceivedMessage) -> ReceivedMessage:
        """Note the dialect of a message of the client, to be translated when it is completed."""
        message.dialect = self._session.dialect
        return message


class ClientContext:
    """Parts of one client that its topics, services, actions and authentication share."""

    __slots__ = ("clock", "graph", "left", "node", "send_at_once", "session", "status", "translator", "wake")

    def __init__(
        self,
        node: Node,
        graph: Graph,
        session: Session,
        clock: Callable[[], float],
        wake: Callable[[], None],
        send_at_once: SendAtOnce = never_at_once,
    ) -> None:
        self.node = node
        self.graph = graph
        self.left = False
        self.session = session
        self.clock = clock
        self.wake = wake
        self.send_at_once = send_at_once
        self.translator = MessageTranslator(session, graph.message_types.registry)
        self.status = ClientStatus(node, session, clock, wake)

    def release(self) -> None:
        """Let go of the connection of a client that has left."""
        self.wake = _do_nothing
        self.send_at_once = never_at_once
        self.status.release()

    def send(self, fields: dict[str, Any]) -> None:
        """Send the client an operation without a message, which is never dropped."""
        if self.session.reply(fields, self.send_at_once):
            self.wake()

    def send_message(self, fields: dict[str, Any], field: str, type_name: str) -> None:
        """Send the client an operation with a message in ROS 2 spelling in ``field``, which is never dropped.

        ``type_name`` is unknown to the registry for values that are sent unchanged.
        """
        if not self.left and self.session.reply(self._translated(fields, field, type_name), self.send_at_once):
            self.wake()

    def send_request(self, fields: dict[str, Any], type_name: str) -> bool:
        """Send the client a call or a goal with its message in ``args``; return False when there is no room for it."""
        if self.left:
            return False
        has_room = self.session.ask(self._translated(fields, "args", type_name), self.send_at_once)
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
            return {**fields, field: self.translator.to_client(type_name, fields[field])}

        return translated if encoding_cost_bytes(fields[field], LARGE_BYTES) >= LARGE_BYTES else translated()
