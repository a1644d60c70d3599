"""Authentication of one client by the op ``auth``, which may have to be its first."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from protocol.operations import Auth, Operation
from protocol.session import Packed, Refusal
from server.access.authentication import AuthThrottle
from server.access.authorization import Access, Authorizer
from server.gateway.client_context import ClientContext
from server.graph.permissions import Identity, display_name

log = logging.getLogger("armbridge.gateway")

# An auth with all its fields at their greatest; a client that has not authenticated may cost no more.
MAX_FIRST_BYTES = 4096

_NOT_FIRST = "the first message must be auth, with a token of this server"


@dataclass(slots=True, eq=False)
class AuthContext:
    """Authentication as a client's connection provides it; wrong tokens count under the IP ``address``."""

    access: Access
    address: str = ""
    throttle: AuthThrottle | None = None
    disconnect: Callable[[str], None] = lambda _reason: None
    on_authenticated: Callable[[], None] = lambda: None

    def release(self) -> None:
        """Let go of the connection of a client that has left."""
        self.disconnect, self.on_authenticated = lambda _reason: None, lambda: None


class ClientAuth:
    """Authentication of one client; a wrong token ends its connection."""

    def __init__(self, context: ClientContext, auth: AuthContext, authorizer: Authorizer) -> None:
        self._client = context
        self._auth = auth
        self._authorizer = authorizer
        self._disconnected = False
        self._identity: Identity | None = None

    def release(self) -> None:
        """Let go of the connection of a client that has left."""
        self._auth.access.one_time_tokens.release(self._identity)
        self._auth.release()

    def check_first_frame(self, frame: str | bytes) -> bool:
        """Check a frame of a client without identity; return True if it may be read."""
        if not self._disconnected and len(frame) > MAX_FIRST_BYTES:
            self._disconnect(_NOT_FIRST)
        return not self._disconnected

    def check_first_operation(self, items: Sequence[Operation | Refusal | Packed]) -> bool:
        """Check the operations in the first frame; return True when the first of them is ``auth``."""
        first = items[0] if items else None
        if isinstance(first, Refusal) and first.op == "auth":
            self._disconnect(first.text)
        elif not isinstance(first, Auth):
            # Without the text that came: it may be a bare token.
            self._disconnect(_NOT_FIRST)
        return not self._disconnected

    def authenticate(self, operation: Auth) -> None:
        """Give the client the identity of the token that it shows, or disconnect it."""
        access, node, tell = self._auth.access, self._client.node, self._client.status.tell
        if not access.tokens.any:
            tell("info", operation, "this server has no tokens; nothing changes")
            return
        throttle, address = self._auth.throttle, self._auth.address
        wait = None if throttle is None else throttle.refusal(address)
        if wait is not None:
            self._disconnect(wait)
            return
        identity = access.identify(operation)
        if isinstance(identity, str):
            if throttle is not None:
                throttle.record_failure(address, operation.token or operation.mac)
            self._disconnect(f"auth: {identity}")
            return
        self._auth.access.one_time_tokens.release(self._identity)
        self._identity = identity
        former, is_new = node.name, identity != node.identity
        self._authorizer.authenticate(identity)
        node.name = display_name(identity, node.address)
        self._auth.on_authenticated()
        role = identity.role.name.lower()
        # The same token may come again and again.
        if is_new:
            log.info("%s is %s, with the role %s", former, node.name, role)
        tell("info", operation, f"this client is {identity.name}, with the role {role}")

    def _disconnect(self, reason: str) -> None:
        self._disconnected = True
        self._client.node.identity = None
        self._authorizer.leave()
        log.warning("%s: %s; closing", self._client.node, reason)
        self._auth.disconnect(reason)
