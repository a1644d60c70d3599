"""Who gets in: decided for each request, before anything else is done for it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from urllib.parse import parse_qs, unquote, urlsplit

from websockets.datastructures import Headers

from protocol.errors import one_line, shorten
from server.access.roles import ANYONE, Identity
from server.access.settings import AccessSettings
from server.access.tokens import Tokens
from server.gateway.entrance.addresses import Authority, read_authority
from server.gateway.entrance.hosts import Hosts, own_names
from server.gateway.entrance.origins import Origins
from server.gateway.entrance.refusal_log import RefusalLog
from server.gateway.entrance.wrong_tokens import WrongTokens
from server.gateway.http_answers import Answer

# What needs the right to view. The page itself does not: it is the same everywhere, and shows a token for all else.
GUARDED = ("metrics", "robot")

# Any page may read the robot's files, as Foxglove's does: a description and its meshes. Where there are tokens, it has
# to know one.
FOR_ANY_ORIGIN = ("robot",)

_BEARER = "bearer "


@dataclass(frozen=True)
class Caller:
    """A request, as far as it matters who sent it.

    Attributes:
        address: where it comes from.
        path: what it asks for, with its query.
        headers: of HTTP.
        upgrade: whether it wants to become a WebSocket.
        encrypted: whether it came over TLS.
    """

    address: str
    path: str
    headers: Headers
    upgrade: bool
    encrypted: bool = False


class Door:
    """Lets requests in, or says why not.

    Args:
        tokens: who may come; None for everybody.
        hosts: names of the server.
        origins: whose pages may connect.
        insecure: whether an address that others can reach may be served without tokens.
        clock: monotonic time [s].

    Attributes:
        tokens: who may come.
        wrong_tokens: by address; also for tokens that come later than the request.
        insecure: as given.
    """

    def __init__(
        self,
        tokens: Tokens | None = None,
        hosts: Hosts | None = None,
        origins: Origins | None = None,
        *,
        insecure: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.tokens = tokens or Tokens({}, ANYONE)
        self.wrong_tokens = WrongTokens(clock)
        self.insecure = insecure
        self._hosts = hosts or Hosts()
        self._origins = origins or Origins()
        self._log = RefusalLog()

    @classmethod
    def of(cls, settings: AccessSettings, tokens: Tokens) -> Door:
        """The door that the settings describe."""
        hosts = Hosts(settings.allowed_hosts, own_names())
        return cls(tokens, hosts, Origins(settings.allowed_origins), insecure=settings.insecure)

    @property
    def refusals(self) -> Mapping[str, int]:
        """How many requests were refused, by what was wrong: host, origin, token, tokens (too many wrong ones)."""
        return self._log.counts

    def admit(self, caller: Caller) -> Identity | Answer | None:
        """Decide about a request.

        Returns:
            Who sent it; None for a client that has yet to say who it is, by the operation ``auth``; an answer for one
            that is refused.
        """
        room = _room(caller.path)
        host = self._host(caller.headers)
        if isinstance(host, Answer):
            return host
        if caller.upgrade or room not in FOR_ANY_ORIGIN:
            refusal = self._foreign(caller, host)
            if refusal is not None:
                return refusal
        admitted = self._identity(caller)
        if admitted is None and not caller.upgrade and room in GUARDED:
            return _unauthorized(f"/{room} needs a token: in the header Authorization: Bearer ..., or as ?token=...")
        return admitted

    def _host(self, headers: Headers) -> Authority | Answer:
        named = headers.get_all("Host")
        if len(named) != 1:
            return Answer.of_text(HTTPStatus.BAD_REQUEST, f"a request needs one Host header, not {len(named)}")
        host = read_authority(named[0])
        if host is not None and self._hosts.has(host):
            return host
        shown = one_line(shorten(named[0]))
        return self._refuse(
            HTTPStatus.MISDIRECTED_REQUEST,
            "host",
            shown,
            f"{shown!r} is no name of this server; if you have given it that one, set"
            f' access.allowed_hosts = ["{shown if host is None else host.host}"]',
        )

    def _foreign(self, caller: Caller, host: Authority) -> Answer | None:
        for origin in caller.headers.get_all("Origin"):
            if not self._origins.has(origin, host, encrypted=caller.encrypted):
                shown = one_line(shorten(origin))
                sentence = (
                    f"pages of the origin {shown!r} may not connect; to let them, set"
                    f' access.allowed_origins = ["{shown}"]'
                )
                return self._refuse(HTTPStatus.FORBIDDEN, "origin", shown, sentence)
        return None

    def _identity(self, caller: Caller) -> Identity | Answer | None:
        presented = _tokens(caller)
        # A server without tokens has no use for one.
        if not presented or not self.tokens.any:
            return self.tokens.anonymous
        if len(presented) > 1:
            return _unauthorized(f"one token is wanted, not {len(presented)}")
        wait = self.wrong_tokens.refusal(caller.address)
        if wait is not None:
            self._log.tell("tokens", caller.address, f"{caller.address}: {wait}")
            retry = {"Retry-After": str(math.ceil(self.wrong_tokens.wait_s(caller.address)))}
            return Answer.of_text(HTTPStatus.TOO_MANY_REQUESTS, wait, retry)
        token = presented.pop()
        owner = self.tokens.identify(token)
        if owner is None:
            self.wrong_tokens.add(caller.address, token)
            self._log.tell("token", caller.address, f"{caller.address} has shown a token that is nobody's")
            return _unauthorized("this token is nobody's")
        return owner

    def _refuse(self, status: HTTPStatus, kind: str, value: str, sentence: str) -> Answer:
        self._log.tell(kind, value, sentence)
        return Answer.of_text(status, sentence)


def _unauthorized(sentence: str) -> Answer:
    return Answer.of_text(HTTPStatus.UNAUTHORIZED, sentence, {"WWW-Authenticate": "Bearer"})


def _tokens(caller: Caller) -> set[str]:
    """The tokens that a request shows, in its header and in its address."""
    lines = caller.headers.get_all("Authorization")
    in_header = [line[len(_BEARER) :].strip() for line in lines if line[: len(_BEARER)].lower() == _BEARER]
    return {*in_header, *parse_qs(_query(caller.path), keep_blank_values=True).get("token", [])}


def _query(path: str) -> str:
    try:
        return urlsplit(path).query
    except ValueError:
        return path.partition("?")[2]


def _room(path: str) -> str:
    """The first part of a path, read as the answer's path is."""
    return unquote(path.partition("?")[0]).removeprefix("/").partition("/")[0]
