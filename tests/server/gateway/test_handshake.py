"""Requests are read as websockets reads them, or not at all."""

from http import HTTPStatus

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.http11 import Request
from websockets.server import ServerProtocol

from server.gateway.websocket import MAX_HEAD_BYTES, MAX_HEADERS, MAX_LINE_BYTES, RequestError, read_request

KEY = "dGhlIHNhbXBsZSBub25jZQ=="
PLAIN = {
    "Host": "localhost:9090",
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Key": KEY,
    "Sec-WebSocket-Version": "13",
}


def request(fields: list[tuple[str, str]], line: str = "GET / HTTP/1.1") -> bytes:
    return "\r\n".join((line, *(f"{name}: {value}" for name, value in fields), "", "")).encode("latin-1", "replace")


def plain(**changes: str | None) -> bytes:
    """The plain request with other values of some headers; None leaves one out."""
    named = {name.replace("_", "-"): value for name, value in changes.items()}
    fields = {**PLAIN, **named}
    return request([(name, value) for name, value in fields.items() if value is not None])


def read(data: bytes) -> Request | HTTPStatus | None:
    try:
        found = read_request(data)
    except RequestError as error:
        return error.status
    return None if found is None else found[0]


def assert_like_websockets(data: bytes) -> None:
    ours = read(data)
    if isinstance(ours, Request):
        protocol = ServerProtocol()
        protocol.receive_data(data)
        theirs = protocol.events_received()[0]
        assert isinstance(theirs, Request)
        assert (ours.method, ours.path, ours.protocol) == (theirs.method, theirs.path, theirs.protocol)
        assert list(ours.headers.raw_items()) == list(theirs.headers.raw_items())


# Values that matter, right and wrong, and any other.
ODD = st.text(st.characters(max_codepoint=255), max_size=12)
VALUES = {
    "Upgrade": st.sampled_from(["websocket", "WebSocket", "websocket, h2c", "h2c", "websocket/13"]),
    "Connection": st.sampled_from(["Upgrade", "keep-alive, Upgrade", "upgrade,close", "keep-alive", "Upgrade, @"]),
    "Sec-WebSocket-Key": st.sampled_from([KEY, KEY[:-1], "AAAAAAAAAAAAAAAAAAAAAB==", "A" * 24, f"{KEY}, {KEY}"]),
    "Sec-WebSocket-Version": st.sampled_from(["13", "8", "13, 8", "١٣".encode().decode("latin-1")]),
    "Sec-WebSocket-Protocol": st.sampled_from(["rosbridge", "a, b", ", ,", "@"]),
    "Sec-WebSocket-Extensions": st.sampled_from(["permessage-deflate", "x; y=", "@"]),
    "Content-Length": st.sampled_from(["0", "5", "x"]),
    "Transfer-Encoding": st.just("chunked"),
    "Origin": st.sampled_from(["http://localhost", "null"]),
    "Host": st.sampled_from(["localhost", "[::1]:9090", ""]),
}
NAMES = st.sampled_from(sorted(VALUES)) | st.text(st.characters(min_codepoint=32, max_codepoint=255), max_size=8)


@st.composite
def field(draw: st.DrawFn) -> tuple[str, str]:
    name = draw(NAMES)
    return draw(st.sampled_from([name, name.lower(), name.upper()])), draw(VALUES.get(name, ODD) | ODD)


REQUESTS = st.builds(
    lambda kept, more, line, end: request([*((name, PLAIN[name]) for name in kept), *more], line) + end,
    st.permutations(sorted(PLAIN)).flatmap(lambda names: st.sampled_from([names, names[1:]])),
    st.lists(field(), max_size=4),
    st.sampled_from([*(f"{part} HTTP/1.1" for part in ("GET /", "GET /a?token=b%20c", "GET /\t", "POST /")), "GET"]),
    st.sampled_from([b"", b"\x81\x80\x00\x00\x00\x00", b"\r\n"]),
)


@given(REQUESTS)
def test_what_is_read_websockets_reads_alike(data: bytes) -> None:
    assert_like_websockets(data)


@given(st.data(), st.binary(min_size=1, max_size=3))
def test_a_request_with_other_bytes_in_it_is_read_alike_or_not_at_all(data: st.DataObject, other: bytes) -> None:
    whole = plain()
    place = data.draw(st.integers(0, len(whole)))
    length = data.draw(st.integers(0, 3))
    assert_like_websockets(whole[:place] + other + whole[place + length :])


def test_a_client_that_begins_tls_is_answered_at_once() -> None:
    with pytest.raises(RequestError, match="the client speaks wss:// or https://, and here is ws:// and http://"):
        read_request(b"\x16\x03\x01\x02\x00")


def test_a_request_as_clients_send_it_is_read_up_to_its_body() -> None:
    for sent in (
        plain(),
        plain(Upgrade="WebSocket", Connection="keep-alive, Upgrade"),
        plain(Origin="http://localhost", User_Agent="Mozilla/5.0 (X11; Linux)", Cookie="a=b; c=d" * 1000),
        plain(Sec_WebSocket_Extensions="permessage-deflate; client_max_window_bits", X="\xe9"),
        plain(Content_Length="0"),
        request([], "GET / HTTP/1.0"),
    ):
        assert isinstance(read(sent), Request), sent
        assert_like_websockets(sent)
        assert read_request(sent + b"\x81") == read_request(sent)
        assert [read(sent[:length]) for length in range(0, len(sent), 50)] == [None] * len(range(0, len(sent), 50))


LONG_LINE = f"/{'x' * MAX_LINE_BYTES}"


def test_any_other_request_is_refused() -> None:
    for sent, status in (
        (plain(Content_Length="5"), HTTPStatus.BAD_REQUEST),
        (plain(Transfer_Encoding="chunked"), HTTPStatus.BAD_REQUEST),
        (plain(X="a\r\n folded"), HTTPStatus.BAD_REQUEST),
        (request([*PLAIN.items()], "get / HTTP/1.1"), HTTPStatus.BAD_REQUEST),
        (request([*PLAIN.items()], "GET / HTTP/2"), HTTPStatus.BAD_REQUEST),
        (request([], f"GET {LONG_LINE} HTTP/1.1"), HTTPStatus.REQUEST_URI_TOO_LONG),
        (LONG_LINE.encode(), HTTPStatus.REQUEST_URI_TOO_LONG),
        (plain(X="x" * MAX_HEAD_BYTES), HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE),
        (plain(X="x" * MAX_HEAD_BYTES)[:-4], HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE),
        (request([("X", "")] * (MAX_HEADERS + 1)), HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE),
    ):
        assert read(sent) is status
