"""Opening handshake in one step, for requests as nearly every client sends them; and requests that may have a body.

All others are left to websockets, which reads no body.

websockets reads a request line by line in a generator, and makes its answer out of parts: together the half of what a
connection costs. Here one pattern shows that a request is whole, that it has each header once, and that websockets
would accept it. The tests hold both ways to the same requests and the same answers.
"""

from __future__ import annotations

import re
import time
from email.utils import formatdate
from functools import lru_cache

from websockets.datastructures import Headers
from websockets.http11 import Request
from websockets.utils import accept_key

# Half of what websockets allows one line: no limit of lines can be reached within it.
MAX_REQUEST_BYTES = 4096

# Names and values as websockets allows them (RFC 9110, 5.1 and 5.5), without values beyond ASCII, and half of the
# headers that it allows. No part can give back what it has matched to the next one, so matching takes one pass.
_HEADER = rb"[-!#$%&'*+.^_`|~0-9a-zA-Z]+:[\t -~]*\r\n"
_REQUEST = re.compile(rb"GET (/[!-~]*) HTTP/1\.1\r\n((?:" + _HEADER + rb"){1,64})\r\n")

# RFC 6455, 4.2.1. The key is 16 bytes in base64.
_CONNECTION = re.compile(r"(?:keep-alive, ?)?upgrade", re.IGNORECASE)
_KEY = re.compile(r"[A-Za-z0-9+/]{22}==")
_VERSION = "13"

# A body, which is refused, and what websockets reads more of than its one line.
_NOT_PLAIN = frozenset(("content-length", "transfer-encoding", "sec-websocket-protocol"))

# POST, PUT, PATCH. HTTP/1.0 is the protocol of old controllers.
_POST = re.compile(rb"(P[A-Z]{2,8}) (/[!-~]*) HTTP/1\.[01]\r\n((?:" + _HEADER + rb"){1,64})\r\n")
_END_OF_HEAD = b"\r\n\r\n"
MAX_HEAD_BYTES = 8192

_ACCEPTED = (
    "HTTP/1.1 101 Switching Protocols\r\nDate: {date}\r\n"
    "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: {accept}\r\n\r\n"
)


def read_upgrade(data: bytes) -> Request | None:
    """Return a request that opens a WebSocket; None for one that is incomplete, not plain, or followed by anything."""
    if len(data) > MAX_REQUEST_BYTES or (found := _REQUEST.fullmatch(data)) is None:
        return None
    path, fields = found[1].decode("ascii"), _fields(found[2])
    values = {name.lower(): value for name, value in fields}
    if len(values) != len(fields) or not _is_plain(values):
        return None
    return Request(path, _headers(fields))


def read_post(data: bytes) -> tuple[Request, int] | None:
    """Return a request that may have a body, and the size of its head; None while the head is incomplete.

    Raises ValueError for anything else.
    """
    end = data.find(_END_OF_HEAD)
    if end < 0 and len(data) <= MAX_HEAD_BYTES:
        return None
    head_bytes = end + len(_END_OF_HEAD)
    if end < 0 or head_bytes > MAX_HEAD_BYTES:
        raise ValueError(f"request line and headers have more than {MAX_HEAD_BYTES} bytes")
    found = _POST.fullmatch(data[:head_bytes])
    if found is None:
        raise ValueError("invalid request line or header")
    method, path = found[1].decode("ascii"), found[2].decode("ascii")
    return Request(path, _headers(_fields(found[3])), method), head_bytes


def _fields(lines: bytes) -> list[tuple[str, str]]:
    pairs = (line.partition(":") for line in lines.decode("ascii").splitlines())
    return [(name, value.strip(" \t")) for name, _, value in pairs]


def _headers(fields: list[tuple[str, str]]) -> Headers:
    headers = Headers()
    for name, value in fields:
        headers[name] = value
    return headers


def _is_plain(values: dict[str, str]) -> bool:
    return (
        values.get("upgrade", "").lower() == "websocket"
        and _CONNECTION.fullmatch(values.get("connection", "")) is not None
        and _KEY.fullmatch(values.get("sec-websocket-key", "")) is not None
        and values.get("sec-websocket-version") == _VERSION
        and _NOT_PLAIN.isdisjoint(values)
    )


def accept(request: Request) -> bytes:
    """Return the bytes of the answer that opens the WebSocket."""
    accepted = accept_key(request.headers["Sec-WebSocket-Key"])
    return _ACCEPTED.format(date=_date(int(time.time())), accept=accepted).encode("ascii")


@lru_cache(maxsize=1)
def _date(second: int) -> str:
    return formatdate(second, usegmt=True)
