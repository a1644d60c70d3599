from __future__ import annotations

from http import HTTPStatus

import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request

from server.gateway.file_cache import StoredFile
from server.gateway.http_answers import Answer, accepts_gzip, names

FILE = StoredFile(b"content", '"name"', gzipped=True)


@pytest.mark.parametrize(
    ("accepted", "takes"),
    [
        ("gzip", True),
        ("br, GZIP;q=0.5", True),
        ("*", True),
        ("gzip;q=1.0", True),
        ("gzip; q=0", False),
        ("gzip;q=0.000, br", False),
        ("br, identity", False),
        ("", False),
        ("gzippy", False),
    ],
)
def test_who_takes_gzip_says_so(accepted: str, takes: bool) -> None:
    assert accepts_gzip(Headers({"Accept-Encoding": accepted})) is takes


def test_a_header_may_come_in_several_lines() -> None:
    headers = Headers([("Connection", "keep-alive"), ("Upgrade", "h2c"), ("Upgrade", "foo, WebSocket")])
    assert names(headers, "Upgrade", "websocket")
    assert not names(headers, "Upgrade", "socket")
    assert not accepts_gzip(headers)


@pytest.mark.parametrize("held", ['"name"', 'W/"name"', '"a", "name"', "*"])
def test_content_that_is_there_already_is_not_sent(held: str) -> None:
    answer = Answer.of_file(FILE, "text/css", "no-cache")
    sent = answer.response(Request("/", Headers({"If-None-Match": held})))
    assert (sent.status_code, sent.body) == (HTTPStatus.NOT_MODIFIED, b"")
    assert sent.headers["ETag"] == '"name"'
    assert not {"Content-Type", "Content-Encoding", "Content-Length"} & set(sent.headers)


def test_other_content_is_sent_with_what_it_is() -> None:
    sent = Answer.of_file(FILE, "text/css", "no-cache").response(Request("/", Headers({"If-None-Match": '"other"'})))
    assert (sent.status_code, sent.body, sent.headers["Content-Encoding"]) == (200, b"content", "gzip")


def test_a_sentence_has_no_name_to_be_known_by() -> None:
    answer = Answer.of_text(HTTPStatus.NOT_FOUND, "no \udcff")
    sent = answer.response(Request("/", Headers({"If-None-Match": "*"})))
    assert (sent.status_code, sent.body, sent.headers["Cache-Control"]) == (404, b"no \\udcff\n", "no-store")
    assert answer.response(Request("/", Headers(), "HEAD")).headers["Content-Length"] == "10"


def test_what_holds_at_the_moment_is_not_to_be_kept() -> None:
    sent = Answer.of_data(HTTPStatus.SERVICE_UNAVAILABLE, b"{}", "application/json").response(Request("/", Headers()))
    assert (sent.status_code, sent.body, sent.headers["Content-Type"]) == (503, b"{}", "application/json")
    assert sent.headers["Cache-Control"] == "no-store"
