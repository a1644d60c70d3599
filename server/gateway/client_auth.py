"""Who a client says it is: the op ``auth``, which may have to be its first."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from protocol.operations import Auth, Operation
from protocol.session import Refusal
from server.access.access import Access
from server.access.guard import Guard
from server.access.roles import called
from server.gateway.client_status import Tell
from server.gateway.entrance.wrong_tokens import WrongTokens
from server.graph.node import Node

log = logging.getLogger("armbridge.gateway")

# An auth with all its fields at their greatest; whoever has not shown a token yet may cost no more.
MAX_FIRST_BYTES = 4096

_NOT_FIRST = "the first message must be auth, with a token of this server"


@dataclass(frozen=True)
class WayIn:
    """What a client's connection knows of the way in.

    Attributes:
        access: who may do what.
        address: IP address of the client, under which its wrong tokens count.
        wrong_tokens: by address; None where nobody counts them.
        shut_out: ends the connection, with a reason.
        let_in: called when a client has shown who it is.
    """

    access: Access
    address: str = ""
    wrong_tokens: WrongTokens | None = None
    shut_out: Callable[[str], None] = lambda _reason: None
    let_in: Callable[[], None] = lambda: None


class ClientAuth:
    """Hears who a client is, and ends its connection when that is wrong.

    Args:
        node: the client.
        guard: what it may do.
        way_in: the way in.
        tell: tells the client something about one of its operations.
    """

    def __init__(self, node: Node, guard: Guard, way_in: WayIn, tell: Tell) -> None:
        self._node = node
        self._guard = guard
        self._way_in = way_in
        self._tell = tell
        self._shut = False
        self.handlers: Mapping[type[Operation], Callable[..., None]] = {Auth: self._auth}

    def may_be_heard(self, frame: str | bytes) -> bool:
        """Whether a frame of a client that is nobody yet is to be read."""
        if not self._shut and len(frame) > MAX_FIRST_BYTES:
            self._shut_out(_NOT_FIRST)
        return not self._shut

    def may_be_first(self, items: Sequence[Operation | Refusal]) -> bool:
        """Whether the first message is one that says who the client is."""
        first = items[0] if items else None
        if isinstance(first, Refusal) and first.op == "auth":
            self._shut_out(first.text)
        elif not isinstance(first, Auth):
            # Without what came: it may be a bare token.
            self._shut_out(_NOT_FIRST)
        return not self._shut

    def _auth(self, operation: Auth) -> None:
        access, node = self._way_in.access, self._node
        if not access.tokens.any:
            self._tell("info", operation, "this server has no tokens; nothing changes")
            return
        wrong_tokens, address = self._way_in.wrong_tokens, self._way_in.address
        wait = None if wrong_tokens is None else wrong_tokens.refusal(address)
        if wait is not None:
            self._shut_out(wait)
            return
        identity = access.identify(operation)
        if isinstance(identity, str):
            if wrong_tokens is not None:
                wrong_tokens.add(address, operation.token or operation.mac)
            self._shut_out(f"auth: {identity}")
            return
        former, is_new = node.name, identity != node.identity
        self._guard.become(identity)
        node.name = called(identity, node.address)
        self._way_in.let_in()
        role = identity.role.name.lower()
        # The same token may come again and again.
        if is_new:
            log.info("%s is %s, with the role %s", former, node.name, role)
        self._tell("info", operation, f"this client is {identity.name}, with the role {role}")

    def _shut_out(self, reason: str) -> None:
        self._shut = True
        self._node.identity = None
        self._guard.leave()
        log.warning("%s: %s; closing", self._node, reason)
        self._way_in.shut_out(reason)
