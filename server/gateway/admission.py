"""Admission: limits of connections, the check of requests by ``Host``, ``Origin`` and token, and open addresses.

A connection counts from the moment when the TCP connection is made, and with TLS when the handshake is done.

A browser lets every page open a WebSocket to every address that its machine reaches, and names the page only
in ``Origin``. A page of another host can have its own name point to the server's address (DNS rebinding),
and is then of one origin with the server for its browser; the name still stands in the ``Host`` header of each request.
"""

import fcntl
import logging
import math
import re
import socket
import struct
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from http import HTTPStatus
from ipaddress import IPv4Address, IPv6Address
from typing import NamedTuple
from urllib.parse import unquote

from websockets.datastructures import Headers

from protocol.errors import one_line, shorten
from robot.logs import LogLimiter
from server.access.authentication import AuthThrottle, Tokens
from server.access.authorization import Access
from server.access.rate_limits import RateLimiter, client_key, is_loopback, parse_address
from server.errors import ConfigurationError
from server.gateway.http import HttpResponse, query_of
from server.gateway.settings import ServerSettings
from server.graph.permissions import Identity, Role

log = logging.getLogger("armbridge.gateway")

# ioctl(2) of netdevice(7): the IPv4 address of an interface.
_SIOCGIFADDR = 0x8915


def host_addresses() -> Sequence[str]:
    """Return the IPv4 addresses at which other machines may reach this one: no loopback or link-local."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[:15])
            try:
                answer = fcntl.ioctl(asked.fileno(), _SIOCGIFADDR, request)
            except OSError:
                # An interface without an IPv4 address.
                continue
            found.append(socket.inet_ntoa(answer[20:24]))
    return [address for address in found if not address.startswith(("127.", "169.254."))]


# Connections at once from an address: as many as the rate allows in this time [s].
BURST_TIME_S = 10

# Refused connections that are answered with the reason: an answer costs a handshake, so a flood gets no answers. Each
# is open for 11 s at most, which makes 120 of them [1/s].
ANSWERS_PER_S = 10

# Addresses without a connection whose rate is remembered.
MAX_ABSENT = 10_000

RETRY_AFTER_S = 5

# Share of one address where fewer clients are served than the settings allow: as in the settings' defaults.
SHARE_OF_ADDRESS = 0.8


class ConnectionSlot(NamedTuple):
    """Place of one connection, to be released at its end, once."""

    rejection: HttpResponse | None
    release: Callable[[], None]


@dataclass(slots=True)
class _Address:
    rate: RateLimiter
    open_count: int = 0


class ConnectionLimiter:
    """Counter of connections."""

    def __init__(self, settings: ServerSettings) -> None:
        self.open_count = 0
        self._settings = settings
        self._max_clients = settings.max_clients
        self._max_per_address = settings.max_clients_per_address
        # Behind the limits in refusals: the reason for which they differ from the settings.
        self._reduction = ""
        # Addresses with connections, and addresses without, the last to leave at the end.
        self._present: dict[str, _Address] = {}
        self._absent: OrderedDict[str, _Address] = OrderedDict()
        self._answers = RateLimiter(ANSWERS_PER_S, ANSWERS_PER_S)
        self._log = LogLimiter()

    def reduce(self, max_clients: int) -> None:
        """Serve fewer clients than the settings allow, as the system lets the server open no more files."""
        self._max_clients = max_clients
        if self._settings.max_clients_per_address < self._settings.max_clients:
            self._max_per_address = min(self._max_per_address, max(1, int(SHARE_OF_ADDRESS * max_clients)))
        self._reduction = ", reduced to the files that the system lets the server open"

    def acquire(self, address: str, now_s: float) -> ConnectionSlot | None:
        """Count a connection; return its place, to be released with it, or None to close it without an answer."""
        key = client_key(address)
        known = self._address(key)
        rejection = self._rejection(known, now_s)
        if rejection is None:
            self._present[key] = known
            known.open_count += 1
            self.open_count += 1
            return ConnectionSlot(None, lambda: self._leave(key, known))
        if not known.open_count:
            self._remember(key, known)
        if not self._answers.take(now_s):
            return None
        status, sentence = rejection
        self._log.write(log, logging.WARNING, f"refused: {address}: {sentence}", address)
        answer = HttpResponse.of_text(status, sentence, {"Retry-After": str(RETRY_AFTER_S)})
        return ConnectionSlot(answer, lambda: None)

    def _address(self, key: str) -> _Address:
        known = self._present.get(key) or self._absent.pop(key, None)
        per_s = self._settings.connections_per_s
        return known or _Address(RateLimiter(per_s, int(BURST_TIME_S * per_s)))

    def _rejection(self, known: _Address, now_s: float) -> tuple[HTTPStatus, str] | None:
        """Return the status of a connection that is one too many, and the reason with the setting to change."""
        limits = self._settings
        if not known.rate.take(now_s):
            limit = f"{limits.connections_per_s:g} a second (server.connections_per_s)"
            return HTTPStatus.TOO_MANY_REQUESTS, f"new connections come too often; the limit is {limit}"
        if known.open_count >= self._max_per_address:
            limit = f"{self._max_per_address} (server.max_clients_per_address{self._reduction})"
            sentence = f"{known.open_count} connections are open from this address, the limit is {limit}"
            return HTTPStatus.TOO_MANY_REQUESTS, sentence
        if self.open_count >= self._max_clients:
            limit = f"{self._max_clients} (server.max_clients{self._reduction})"
            sentence = f"{self.open_count} connections are open, the limit is {limit}"
            return HTTPStatus.SERVICE_UNAVAILABLE, sentence
        return None

    def _leave(self, key: str, known: _Address) -> None:
        self.open_count -= 1
        known.open_count -= 1
        if not known.open_count:
            del self._present[key]
            self._remember(key, known)

    def _remember(self, key: str, known: _Address) -> None:
        self._absent[key] = known
        self._absent.move_to_end(key)
        if len(self._absent) > MAX_ABSENT:
            self._absent.popitem(last=False)


# Paths that need the right to view. The page itself does not: it is the same everywhere, and asks for a token itself.
GUARDED = ("armbridge", "goal", "metrics", "robot")

# Any page may read the robot's files, as Foxglove's does: a description and its meshes. Where there are tokens, it has
# to know one.
FOR_ANY_ORIGIN = ("robot",)

_BEARER = "bearer "

MAX_PORT = 65_535

_AUTHORITY = re.compile(
    r"(?:\[(?P<ipv6>[0-9A-Fa-f:.]{2,45})(?:%[0-9A-Za-z._~-]{1,32})?\]|(?P<name>[0-9A-Za-z_.-]{1,255}))"
    r"(?::(?P<port>[0-9]{1,5}))?"
)

# Of the schemes that pages have.
_PORTS = {"http": 80, "https": 443}


@dataclass(frozen=True)
class Authority:
    """Host, a lower-case name or an IP address, and port as a header names them; None for the scheme's port."""

    host: str
    port: int | None = None

    @cached_property
    def address(self) -> IPv4Address | IPv6Address | None:
        """The host as an IP address; None for a name."""
        return parse_address(self.host)

    @property
    def is_loopback(self) -> bool:
        """True for this machine, by address or as ``localhost``."""
        address = self.address
        return self.host == "localhost" if address is None else address.is_loopback


def read_authority(text: str) -> Authority | None:
    """Return host and port of a header; None for any other text, such as one with a user in it."""
    found = _AUTHORITY.fullmatch(text)
    if found is None:
        return None
    port = None if found["port"] is None else int(found["port"])
    if port is not None and port > MAX_PORT:
        return None
    if found["ipv6"] is not None:
        address = parse_address(found["ipv6"])
        return Authority(str(address), port) if isinstance(address, IPv6Address) else None
    # The dot marks a name as complete; it is no other name for that.
    host = found["name"].lower().removesuffix(".")
    return Authority(host, port) if host and not host.endswith(".") else None


def matches(text: str, pattern: str) -> bool:
    """Return True for a text that fits a pattern: ``*`` is any text, brackets are themselves, as in IPv6 addresses."""
    return fnmatchcase(text, pattern.replace("[", "[[]"))


def is_server(host: Authority, own: Collection[str], allowed: Iterable[str] = ()) -> bool:
    """Return True for a host that is the server: every IP address, localhost, ``own`` names, ``allowed`` patterns."""
    if host.host in ("localhost", *own) or host.address is not None:
        return True
    names = (host.host, f"{host.host}:{host.port}")
    return any(matches(name, pattern.lower()) for pattern in allowed for name in names)


def own_names(hostname: str | None = None) -> Sequence[str]:
    """Return the names of this machine that need no look-up: its hostname, and its name in multicast DNS."""
    name = (socket.gethostname() if hostname is None else hostname).lower()
    short = name.partition(".")[0]
    return (name, short, f"{short}.local") if short else ()


def may_connect(
    origin: str, host: Authority, allowed: Iterable[str] = (), classroom_ports: Collection[int] = (), *, encrypted: bool
) -> bool:
    """Return True for an origin whose pages may connect: this machine's, the server's own, and ``allowed`` patterns.

    The pages of other servers of a classroom have its host and one of the classroom's ports.
    """
    origin = origin.lower()
    # As people copy it out of a browser, an origin ends in a slash.
    if any(matches(origin, text) for each in allowed for text in (each.lower(), each.lower().removesuffix("/"))):
        return True
    scheme, separator, rest = origin.partition("://")
    theirs = read_authority(rest) if separator and scheme in _PORTS else None
    if theirs is None:
        return False
    own_scheme = "https" if encrypted else "http"
    usual_port = _PORTS[own_scheme]
    port = theirs.port or usual_port
    own_port = port == (host.port or usual_port) or port in classroom_ports
    return theirs.is_loopback or (scheme == own_scheme and theirs.host == host.host and own_port)


class HandshakeRequest(NamedTuple):
    """Request of a client, as far as admission looks at it."""

    address: str
    path: str
    headers: Headers
    upgrade: bool
    encrypted: bool = False


class AdmissionPolicy:
    """Checks each request by host, origin and token before anything else is done for it."""

    def __init__(self, access: Access, classroom_ports: Collection[int] = ()) -> None:
        self.auth_throttle = AuthThrottle(access.clock)
        self._access, self._classroom_ports = access, classroom_ports
        self._own_names = own_names()
        self._log = LogLimiter()

    def check(self, request: HandshakeRequest) -> Identity | HttpResponse | None:
        """Return the identity of a sender, None before it has authenticated, or the answer that refuses it."""
        # Decoded as :mod:`server.gateway.http` decodes it.
        area = unquote(request.path.partition("?")[0]).removeprefix("/").partition("/")[0]
        host = self._host(request.headers)
        if isinstance(host, HttpResponse):
            return host
        if request.upgrade or area not in FOR_ANY_ORIGIN:
            refusal = self._foreign(request, host)
            if refusal is not None:
                return refusal
        if request.upgrade and (wrong := wrong_choice(query_of(request.path))):
            return self._refuse(HTTPStatus.BAD_REQUEST, "query", wrong, wrong)
        admitted = self._identity(request)
        if admitted is None and not request.upgrade and area in GUARDED:
            return _unauthorized(f"/{area} needs a token: in the header Authorization: Bearer ..., or as ?token=...")
        return admitted

    def _host(self, headers: Headers) -> Authority | HttpResponse:
        named = headers.get_all("Host")
        if len(named) != 1:
            return HttpResponse.of_text(HTTPStatus.BAD_REQUEST, f"a request needs one Host header, not {len(named)}")
        host = read_authority(named[0])
        if host is not None and is_server(host, self._own_names, self._access.settings.allowed_hosts):
            return host
        shown = one_line(shorten(named[0]))
        return self._refuse(
            HTTPStatus.MISDIRECTED_REQUEST,
            "host",
            shown,
            f"{shown!r} is no name of this server; if you have given it that one, set"
            f' access.allowed_hosts = ["{shown if host is None else host.host}"]',
        )

    def _foreign(self, request: HandshakeRequest, host: Authority) -> HttpResponse | None:
        allowed, ports = self._access.settings.allowed_origins, self._classroom_ports
        for origin in request.headers.get_all("Origin"):
            if not may_connect(origin, host, allowed, ports, encrypted=request.encrypted):
                shown = one_line(shorten(origin))
                sentence = (
                    f"pages of the origin {shown!r} may not connect; to let them, set"
                    f' access.allowed_origins = ["{shown}"]'
                )
                return self._refuse(HTTPStatus.FORBIDDEN, "origin", shown, sentence)
        return None

    def _identity(self, request: HandshakeRequest) -> Identity | HttpResponse | None:
        presented, tokens = _presented_tokens(request), self._access.tokens
        # A server without tokens has no use for one.
        if not presented or not tokens.any:
            return tokens.anonymous
        if len(presented) > 1:
            return _unauthorized(f"one token is wanted, not {len(presented)}")
        wait = self.auth_throttle.refusal(request.address)
        if wait is not None:
            self._log_refusal("tokens", request.address, f"{request.address}: {wait}")
            retry = {"Retry-After": str(math.ceil(self.auth_throttle.wait_s(request.address)))}
            return HttpResponse.of_text(HTTPStatus.TOO_MANY_REQUESTS, wait, retry)
        token = presented.pop()
        owner = tokens.identify(token)
        if owner is None and not request.upgrade:
            # The page that came in with a one-time token asks for the robot's meshes with it.
            owner = self._access.one_time_tokens.reader(token)
        if owner is None:
            self.auth_throttle.record_failure(request.address, token)
            self._log_refusal("token", request.address, f"{request.address} has shown an invalid token")
            return _unauthorized("invalid token")
        return owner

    def _refuse(self, status: HTTPStatus, kind: str, value: str, sentence: str) -> HttpResponse:
        self._log_refusal(kind, value, sentence)
        return HttpResponse.of_text(status, sentence)

    def _log_refusal(self, kind: str, value: str, sentence: str) -> None:
        self._log.write(log, logging.WARNING, f"refused: {sentence}", (kind, value))


def check_exposure(host: str, addresses: Iterable[str], tokens: Tokens, *, insecure: bool) -> None:
    """Refuse an address that others can reach without tokens, unless ``access.insecure`` allows it; warn of it.

    Raises ConfigurationError.
    """
    reachable = next((address for address in addresses if not is_loopback(address)), None)
    if reachable is None:
        return
    where = host if host == reachable else f"{host or 'every address'} ({reachable})"
    anonymous = tokens.anonymous
    may_move = anonymous is not None and anonymous.role >= Role.OPERATE
    if not insecure and not tokens.any:
        raise ConfigurationError(
            f"server.host: others can reach {where}, and nothing keeps them from moving the arm; set a token, as in"
            " ARMBRIDGE_ACCESS__TOKEN=..., or say --insecure if everybody there may"
        )
    if not insecure and may_move:
        raise ConfigurationError(
            f"access.without_token: others can reach {where} and move the arm without a token; set it to view or none,"
            " or say --insecure if everybody there may"
        )
    if anonymous is not None and may_move:
        log.warning(
            "INSECURE: anyone at %s may connect without a token as %s; docs/security.md says how to change that",
            where,
            anonymous.role.name.lower(),
        )


# Choices in the query of a client's URL.
_CHOICES = {"ros": ("1", "2"), "on_disconnect": ("finish", "stop")}


def wrong_choice(query: Mapping[str, Sequence[str]]) -> str:
    """Return the sentence that refuses a query: a mistyped ``stop`` would let the arm go on. Empty for a right one."""
    for name, values in _CHOICES.items():
        for value in query.get(name, ()):
            if value not in values:
                return f"?{name}= must be {' or '.join(values)}, not {one_line(shorten(value))!r}"
    return ""


def _unauthorized(sentence: str) -> HttpResponse:
    return HttpResponse.of_text(HTTPStatus.UNAUTHORIZED, sentence, {"WWW-Authenticate": "Bearer"})


def _presented_tokens(request: HandshakeRequest) -> set[str]:
    lines = request.headers.get_all("Authorization")
    in_header = [line[len(_BEARER) :].strip() for line in lines if line[: len(_BEARER)].lower() == _BEARER]
    return {*in_header, *query_of(request.path).get("token", [])}
