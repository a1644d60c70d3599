"""What is sent in answer to an HTTP request: its headers, and whether its body is needed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from email.utils import formatdate
from http import HTTPStatus

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from server.gateway.file_cache import StoredFile

# Nothing of another host is loaded or asked, nothing runs that is not a file of ours, nobody frames the page: whoever
# made a person click on a page within a page would move the arm. Textures are made from data and blobs.
POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' data: blob:",
        "font-src 'self'",
        "connect-src 'self' blob:",
        "manifest-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)

_WEIGHT_OF_NOTHING = re.compile(r"q\s*=\s*0(\.0*)?")

# A connection serves one request: websockets closes it after the answer.
_ALWAYS = {
    "Connection": "close",
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
}


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a request.

    Attributes:
        status: its number.
        body: what a GET gets.
        headers: those of this answer.
    """

    status: HTTPStatus
    body: bytes
    headers: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_text(cls, status: HTTPStatus, text: str, headers: Mapping[str, str] | None = None) -> Answer:
        """A sentence for whoever reads it."""
        about = {"Content-Type": "text/plain; charset=utf-8", "Cache-Control": "no-store"}
        # A file's name may have what is no character.
        return cls(status, f"{text}\n".encode(errors="backslashreplace"), {**about, **(headers or {})})

    @classmethod
    def of_data(cls, status: HTTPStatus, body: bytes, media_type: str) -> Answer:
        """What holds at the moment of asking, for programs."""
        return cls(status, body, {"Content-Type": media_type, "Cache-Control": "no-store"})

    @classmethod
    def of_html(cls, status: HTTPStatus, text: str) -> Answer:
        """A page of the server's own."""
        return cls(status, text.encode(), {"Content-Type": "text/html; charset=utf-8", "Cache-Control": "no-store"})

    @classmethod
    def of_file(
        cls, file: StoredFile, media_type: str, keeping: str, headers: Mapping[str, str] | None = None
    ) -> Answer:
        """A file.

        Args:
            file: its content.
            media_type: what it is.
            keeping: how long a browser keeps it, as Cache-Control says it.
            headers: more to be said.
        """
        about = {"Content-Type": media_type, "Cache-Control": keeping, "ETag": file.etag, "Vary": "Accept-Encoding"}
        if file.gzipped:
            about["Content-Encoding"] = "gzip"
        return cls(HTTPStatus.OK, file.octets, {**about, **(headers or {})})

    def response(self, request: Request) -> Response:
        """What goes out for a request: less when its sender has the content, or asks for no body."""
        etag = self.headers.get("ETag")
        unchanged = etag is not None and _has(request.headers, etag)
        status = HTTPStatus.NOT_MODIFIED if unchanged else self.status
        headers = Headers({"Date": formatdate(usegmt=True), **_ALWAYS, **self.headers})
        if unchanged:
            del headers["Content-Type"]
            headers.pop("Content-Encoding", None)
        else:
            headers["Content-Length"] = str(len(self.body))
        return Response(status, status.phrase, headers, b"" if unchanged or request.method == "HEAD" else self.body)


def names(headers: Headers, header: str, token: str) -> bool:
    """Whether a header of comma-separated words has one of them."""
    return any(word.strip().lower() == token for line in headers.get_all(header) for word in line.split(","))


def accepts_gzip(headers: Headers) -> bool:
    """Whether a client takes a compressed body."""
    for line in headers.get_all("Accept-Encoding"):
        for item in line.lower().split(","):
            coding, _, weight = item.partition(";")
            if coding.strip() in ("gzip", "*"):
                return not _WEIGHT_OF_NOTHING.fullmatch(weight.strip())
    return False


def _has(headers: Headers, etag: str) -> bool:
    """Whether a client has the content of that name."""
    held = [item.strip().removeprefix("W/") for line in headers.get_all("If-None-Match") for item in line.split(",")]
    return etag in held or "*" in held
