"""One-time tokens: each lets one connection in, soon after an administrator asked for it, as for a phone's QR code."""

import hmac
import logging
import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from server.access.authentication import Tokens, digest_of
from server.errors import ServiceError
from server.graph.permissions import CONFIGURING, Identity, Role
from server.graph.services import Call, answer
from server.graph.topics import Graph

log = logging.getLogger("armbridge.access")

SERVICE = "/armbridge/issue_one_time_token"
SERVICE_TYPE = "armbridge_msgs/srv/IssueOneTimeToken"

# Time to take a phone and scan a code.
VALID_FOR_S = 120.0

# Tokens that wait for their connection; beyond it the oldest is revoked, as of a page that shows a new code.
MAX_WAITING = 8

# 128 bits: nobody guesses one in its two minutes.
TOKEN_BYTES = 16

_ROLES = {role.name.lower(): role for role in Role}
DEFAULT_ROLE = "operate"


@dataclass
class _Issued:
    digest: bytes
    identity: Identity
    until_s: float
    used: bool = False


class OneTimeTokens:
    """One-time tokens that wait for their connection, and tokens of open connections."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._issued: list[_Issued] = []
        self._count = 0

    def issue(self, asker: Identity | None, role: str) -> str:
        """Return a new token, or raise ServiceError for an unknown role or one above the asker's."""
        wanted = _ROLES.get(role or DEFAULT_ROLE)
        if wanted is None:
            raise ServiceError(f"field role: must be {', '.join(_ROLES)}, not {role[:40]!r}")
        if asker is None or wanted > asker.role:
            has = "none" if asker is None else asker.role.name.lower()
            raise ServiceError(f"field role: {wanted.name.lower()} is above the role of this client, {has}")
        waiting = [each for each in self._issued if not each.used]
        if len(waiting) >= MAX_WAITING:
            self._issued.remove(waiting[0])
        self._count += 1
        token = secrets.token_urlsafe(TOKEN_BYTES)
        identity = Identity(f"one-time-{self._count}", wanted)
        self._issued.append(_Issued(digest_of(token), identity, self._clock() + VALID_FOR_S))
        return token

    def use(self, presented: str) -> Identity | None:
        """Return the identity that a token gives to a connection, once; None for an unknown or used token."""
        found = self._find(presented)
        if found is None or found.used:
            return None
        found.used = True
        return found.identity

    def reader(self, presented: str) -> Identity | None:
        """Return the identity that a token gives to a request over HTTP, while its connection is open: to view."""
        found = self._find(presented)
        return Identity(found.identity.name, Role.VIEW) if found is not None and found.used else None

    def release(self, identity: Identity | None) -> None:
        self._issued = [each for each in self._issued if not (each.used and each.identity == identity)]

    def _find(self, presented: str) -> _Issued | None:
        """Return what was issued as this token; every one is compared, in constant time."""
        now_s = self._clock()
        self._issued = [each for each in self._issued if each.used or now_s < each.until_s]
        wanted, found = digest_of(presented), None
        for each in self._issued:
            if hmac.compare_digest(each.digest, wanted):
                found = each
        return found


def offer_one_time_tokens(
    graph: Graph, one_time_tokens: OneTimeTokens, tokens: Tokens, page_urls: Callable[[], Sequence[str]]
) -> None:
    """Offer the service that issues one-time tokens, with the addresses of the page for other machines."""

    def issue(call: Call) -> dict[str, Any]:
        role, urls = call.request["role"], list(page_urls())
        place = {"urls": urls, "encrypted": any(url.startswith("https:") for url in urls)}
        if not tokens.any:
            message = "this server has no tokens: everybody who reaches it may move the arm"
            return {"success": True, "message": message} | place
        try:
            token = one_time_tokens.issue(call.caller.identity, role)
        except ServiceError as error:
            return {"success": False, "message": str(error)} | place
        # Without the token, which is in no log.
        log.info("%s has got a one-time token for the role %s", call.caller, role or DEFAULT_ROLE)
        message = f"the token lets one connection in within {VALID_FOR_S:g} s"
        return {"success": True, "message": message, "token": token, "expires_in_s": VALID_FOR_S} | place

    graph.node("one-time tokens").offer_calls(
        SERVICE, SERVICE_TYPE, lambda call: answer(call, lambda _request: issue(call)), rule=CONFIGURING
    )
