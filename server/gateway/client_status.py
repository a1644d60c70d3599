"""What one client is told beside the answers to its operations: errors, warnings and acknowledgements.

The levels mean what the rosbridge protocol says of them (section 3.2, status): an error is what is not carried out, a
warning what is but was most likely not meant so, info that something has succeeded.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple, TypeAlias

from protocol.errors import NothingToDoError, OperationError, ProtocolError, one_line, shorten
from protocol.operations import (
    Advertise,
    AdvertiseAction,
    AdvertiseService,
    Operation,
    SetLevel,
    Status,
    Subscribe,
    Unadvertise,
    UnadvertiseAction,
    UnadvertiseService,
    Unsubscribe,
)
from protocol.session import Refusal, Session
from server.errors import GraphError
from server.gateway.log_share import LogShare
from server.graph.node import Node

Tell: TypeAlias = Callable[[Literal["warning", "info"], Operation, str], None]

_LOG_LEVELS = {"none": logging.DEBUG, "error": logging.ERROR, "warning": logging.WARNING, "info": logging.INFO}


class _Done(NamedTuple):
    """How the success of an operation is told: the field with the name of what it was about, and what happened."""

    field: str
    words: str


# Those that rosbridge answers with nothing; publish is left out, for it would be told for every message.
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
    """Tells a client what it has asked for with ``set_level``, and the log what concerns the server's user.

    Args:
        node: the client.
        session: its protocol state.
        wake: called when there is something to send.

    Attributes:
        refused: how many operations were not carried out.
    """

    def __init__(self, node: Node, session: Session, wake: Callable[[], None]) -> None:
        self.refused = 0
        self._node = node
        self._session = session
        self._wake = wake
        self._turned_away = ""
        # Most clients do nothing wrong.
        self._log_share: LogShare | None = None

    @property
    def handlers(self) -> Mapping[type[Operation], Callable[..., None]]:
        """What carries which operation out."""
        return {
            SetLevel: self._set_level,
            Status: self._log_status,
        }

    def refuse(self, refusal: Refusal) -> None:
        """Say that something is not carried out."""
        self.refused += 1
        text = one_line(refusal.text)
        self._log(logging.WARNING, f"{self._node}: refused: {text}")
        self._session.status("error", text, refusal.id)
        self._wake()

    def turn_away(self, operation: Operation, reason: str) -> None:
        """Say that the client may not do something; the log hears it once, for a client may ask many times a second."""
        self.refused += 1
        text = one_line(f"{operation.op}: {reason}")
        if text != self._turned_away:
            self._log(logging.WARNING, f"{self._node}: refused: {text}")
        self._turned_away = text
        self._session.status("error", text, operation.id)
        self._wake()

    def refuse_error(self, op: str, error: ProtocolError | GraphError, mark: str | int | None = None) -> None:
        """Say that an operation has ended with an error."""
        # An OperationError names the operation itself.
        text = str(error) if isinstance(error, OperationError) else f"{op}: {error}"
        if isinstance(error, NothingToDoError):
            self._session.status("warning", text, mark)
            self._wake()
        else:
            self.refuse(Refusal(op, mark, text))

    def tell(self, level: Literal["warning", "info"], operation: Operation, text: str) -> None:
        """Say something about an operation that is carried out."""
        self._session.status(level, f"{operation.op}: {text}", operation.id)
        self._wake()

    def acknowledge(self, operation: Operation) -> None:
        """Say that an operation has been carried out, if nothing else says so."""
        done = _DONE.get(type(operation))
        if done is not None:
            self.tell("info", operation, f"{done.field} {getattr(operation, done.field)}: {done.words}")
        if isinstance(operation, Advertise | Subscribe) and operation.qos:
            self.tell("warning", operation, "field qos: has no effect")

    def _set_level(self, operation: SetLevel) -> None:
        self._session.status_level = operation.level

    def _log_status(self, operation: Status) -> None:
        self._log(_LOG_LEVELS[operation.level], f"{self._node} says: {one_line(shorten(operation.msg))}")

    def _log(self, level: int, text: str) -> None:
        if self._log_share is None:
            self._log_share = LogShare()
        self._log_share.write(time.monotonic(), level, text)
