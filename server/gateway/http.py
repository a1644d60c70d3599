"""HTTP on the port of rosbridge: the page at ``/``, the robot's files below ``/robot/``, routes, and posted requests.

One request a connection, answered before there is a WebSocket; requests to upgrade pass, whatever path they have. Files
are read, compressed and named by their content once, and kept while they do not change.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import logging
import re
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass, field
from email.utils import formatdate
from http import HTTPStatus
from mimetypes import MimeTypes
from pathlib import Path, PurePath
from typing import TypeAlias
from urllib.parse import parse_qs, unquote

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from protocol.errors import one_line, shorten
from robot.description.model import RobotModel
from robot.logs import LogLimiter
from server.disk import Disk
from server.errors import FileTooLargeError, ServiceError
from server.graph.permissions import Identity
from server.installation import DOCS_DIRECTORY, PAGE_DIRECTORY
from server.robot_files import RobotFiles, file_below, with_package_urls

log = logging.getLogger("armbridge.gateway")

# Answers a request for one path.
Route: TypeAlias = Callable[[Request], Awaitable["HttpResponse"]]

# Answers a request with a body for one path; cancelled when the client leaves before its answer.
PostRoute: TypeAlias = Callable[["PostedRequest"], Awaitable["HttpResponse"]]

METHODS = ("GET", "HEAD")

# A goal for 200 joints has 20 kB, and the event loop reads this much JSON within 1 ms.
MAX_BODY_BYTES = 32_768

# A page of another site can post a form or plain text without asking first, but no JSON (Fetch standard,
# "CORS-safelisted request-header").
BODY_TYPE = "application/json"

# What clients may leave unread in all. The meshes of an arm, to a dozen browsers at a time.
MAX_UNREAD_BYTES = 256 << 20

ROBOT = "robot"

# Names that vite gives to files with a hash of their content: such a file never changes.
_HASHED = re.compile(r"assets/[^/]+-[A-Za-z0-9_-]{8}\.[a-z0-9.]+")
_FOR_EVER = "public, max-age=31536000, immutable"

# Kept by the browser, and asked about at each use: an ETag that still holds costs 300 bytes.
_ASK_AGAIN = "no-cache"

# Nothing of another host is loaded or asked, nothing runs that is not a file of ours, nobody frames the page: a
# click on a page within a page would move the arm. Textures are made from data and blobs.
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

# As long as a number may be that is still compared with the limit.
_LENGTH = re.compile(r"[0-9]{1,18}")

# A connection serves one request: websockets closes it after the answer.
_HEADERS_OF_ALL = {
    "Connection": "close",
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
}

INDEX = "index.html"

# The page's largest file, its libraries, has one.
MAX_PAGE_FILE_BYTES = 8 << 20

DOCS = "docs"

HOW_TO_BUILD_PAGE = "the page is not built: install Node.js 20.19 or later with npm, and call make page"

UNKNOWN_TYPE = "application/octet-stream"

# Python's own table, as the machine's gets ``.js`` wrong on some systems, with what it lacks.
_TYPES = MimeTypes()
for _suffix, _type in {
    ".js": "text/javascript",
    ".mjs": "text/javascript",
    # Browsers show plain text, and save Markdown.
    ".md": "text/plain",
    ".map": "application/json",
    ".webp": "image/webp",
    ".urdf": "application/xml",
    ".srdf": "application/xml",
    ".dae": "model/vnd.collada+xml",
    ".gltf": "model/gltf+json",
    ".glb": "model/gltf-binary",
    ".stl": "model/stl",
    ".obj": "model/obj",
    ".mtl": "model/mtl",
}.items():
    _TYPES.add_type(_type, _suffix)
_TEXT = re.compile(r"text/.*|.*[/+](json|xml)")

# What has little to gain by another compression.
_COMPRESSED = frozenset((".png", ".jpg", ".jpeg", ".webp"))

# The page has one megabyte, an arm's meshes at their full size have 16, and less again when both forms are asked for.
CACHE_BYTES = 64 << 20

# Below this size the header outweighs the gain.
MIN_GZIP_BYTES = 1000

# Twice the time of the lowest level for a tenth less; more gains nothing on scripts and meshes.
GZIP_LEVEL = 6

# A slow machine compresses 10 MB a second: time for a large mesh [s].
READING_TIMEOUT_S = 30.0

# 96 bits tell all files ever served apart.
ETAG_DIGITS = 24


@dataclass(frozen=True, slots=True)
class StoredFile:
    """Content of a file, plain or compressed."""

    octets: bytes
    etag: str
    gzipped: bool

    @classmethod
    def of(cls, octets: bytes, *, gzipped: bool) -> StoredFile:
        """Return content, compressed if that is wanted and makes it smaller."""
        digits = hashlib.sha256(octets).hexdigest()[:ETAG_DIGITS]
        if gzipped and len(octets) >= MIN_GZIP_BYTES:
            smaller = gzip.compress(octets, GZIP_LEVEL, mtime=0)
            if len(smaller) < len(octets):
                return cls(smaller, f'"{digits}-gzip"', gzipped=True)
        return cls(octets, f'"{digits}"', gzipped=False)


# A change of path, time, size or form is a change of the file.
_Key = tuple[Path, int, int, bool]


class FileCache:
    """Cache of files; reads them on a thread, one at a time: no slow disk and no large file delays the server."""

    def __init__(self, limit_bytes: int = CACHE_BYTES) -> None:
        self._limit_bytes = limit_bytes
        self._kept: OrderedDict[_Key, StoredFile] = OrderedDict()
        self._kept_bytes = 0
        self._disk = Disk(READING_TIMEOUT_S)

    async def read(self, find: Callable[[], Path], *, gzipped: bool) -> StoredFile:
        """Return a file from cache or disk, or raise OSError; ``find`` returns its path, on the thread."""
        return await self._disk.do(lambda: self._read(find, gzipped))

    def _read(self, find: Callable[[], Path], gzipped: bool) -> StoredFile:
        path = find()
        state = path.stat()
        key = (path, state.st_mtime_ns, state.st_size, gzipped)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        file = StoredFile.of(path.read_bytes(), gzipped=gzipped)
        self._kept[key] = file
        self._kept_bytes += len(file.octets)
        while self._kept_bytes > self._limit_bytes:
            _, dropped = self._kept.popitem(last=False)
            self._kept_bytes -= len(dropped.octets)
        return file


def media_type(name: str) -> str:
    """Return the Content-Type of a file by its suffix."""
    found, packed = _TYPES.guess_type(name)
    if found is None or packed is not None:
        return UNKNOWN_TYPE
    return f"{found}; charset=utf-8" if _TEXT.fullmatch(found) else found


def page_is_built(directory: Path) -> bool:
    return (directory / INDEX).is_file()


def find_page_file(directory: Path, name: str) -> Path:
    """Return the path of a file of the page, the page itself for an empty name; raises as :func:`file_below`."""
    return file_below(directory, name or INDEX, repr(f"/{name}"), "of the page", MAX_PAGE_FILE_BYTES)


@dataclass(frozen=True, slots=True)
class HttpResponse:
    """Answer to a request."""

    status: HTTPStatus
    body: bytes
    headers: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_text(cls, status: HTTPStatus, text: str, headers: Mapping[str, str] | None = None) -> HttpResponse:
        # A file name may have bytes that are no UTF-8.
        body = f"{text}\n".encode(errors="backslashreplace")
        return cls.of_data(status, body, "text/plain; charset=utf-8", headers)

    @classmethod
    def of_data(
        cls, status: HTTPStatus, body: bytes, media_type: str, headers: Mapping[str, str] | None = None
    ) -> HttpResponse:
        """Return an answer with data that are not to be cached."""
        return cls(status, body, {"Content-Type": media_type, "Cache-Control": "no-store", **(headers or {})})

    @classmethod
    def of_json(cls, status: HTTPStatus, value: object) -> HttpResponse:
        return cls.of_data(status, json.dumps(value).encode() + b"\n", BODY_TYPE)

    @classmethod
    def of_failure(cls, status: HTTPStatus, sentence: str) -> HttpResponse:
        """Return the answer to a posted request that failed."""
        return cls.of_json(status, {"success": False, "message": sentence})

    @classmethod
    def of_file(
        cls, file: StoredFile, media_type: str, keeping: str, headers: Mapping[str, str] | None = None
    ) -> HttpResponse:
        about = {"Content-Type": media_type, "Cache-Control": keeping, "ETag": file.etag, "Vary": "Accept-Encoding"}
        if file.gzipped:
            about["Content-Encoding"] = "gzip"
        return cls(HTTPStatus.OK, file.octets, {**about, **(headers or {})})

    def response(self, request: Request) -> Response:
        """Return the response to a request: without a body when its sender has the content, or asks for none."""
        etag = self.headers.get("ETag")
        lines = request.headers.get_all("If-None-Match")
        held = [item.strip().removeprefix("W/") for line in lines for item in line.split(",")]
        unchanged = etag is not None and (etag in held or "*" in held)
        status = HTTPStatus.NOT_MODIFIED if unchanged else self.status
        headers = Headers({"Date": formatdate(usegmt=True), **_HEADERS_OF_ALL, **self.headers})
        if unchanged:
            del headers["Content-Type"]
            headers.pop("Content-Encoding", None)
        else:
            headers["Content-Length"] = str(len(self.body))
        return Response(status, status.phrase, headers, b"" if unchanged or request.method == "HEAD" else self.body)


@dataclass(frozen=True, slots=True)
class PostedRequest:
    """Request with a body, the client's ``address`` as ``10.0.0.5:50000``, and the stop epoch in which it arrived."""

    request: Request
    body: bytes
    identity: Identity
    address: str
    epoch: int

    @property
    def query(self) -> Mapping[str, list[str]]:
        return query_of(self.request.path)


def query_of(path: str) -> dict[str, list[str]]:
    """Return the values of a request's query by name, from behind the question mark."""
    return parse_qs(path.partition("?")[2], keep_blank_values=True)


def names(headers: Headers, header: str, token: str) -> bool:
    """Return True for a header of comma-separated words that has a word, whatever its weight."""
    words = (word.partition(";")[0] for line in headers.get_all(header) for word in line.split(","))
    return any(word.strip().lower() == token for word in words)


class HttpHandler:
    """Handler of requests over HTTP; routes, by path without its first slash, come before the page's files."""

    def __init__(
        self,
        robot: RobotModel | None = None,
        page_directory: Path = PAGE_DIRECTORY,
        routes: Mapping[str, Route] | None = None,
        post_routes: Mapping[str, PostRoute] | None = None,
        docs_directory: Path = DOCS_DIRECTORY,
        classroom_ports: Iterable[int] = (),
    ) -> None:
        self._files = None if robot is None else RobotFiles(robot)
        self._routes = {} if routes is None else routes
        self._post_routes = {} if post_routes is None else post_routes
        self._page_directory = page_directory
        # Browsers know no pattern for other ports of the page's own host.
        sources = "".join(f" ws://*:{port} wss://*:{port}" for port in classroom_ports)
        self._policy = POLICY.replace("connect-src 'self'", f"connect-src 'self'{sources}")
        self._docs_directory = docs_directory
        # Large meshes do not put the page out, nor does their disk hold it up.
        self._page_files = FileCache()
        self._robot_files = FileCache()
        self._descriptions: dict[str, bytes] = {}
        if robot is not None:
            urdf, srdf = with_package_urls(robot), robot.srdf
            self._descriptions = {"description.urdf": urdf.encode(), "description.srdf": srdf.encode()}
        self._log = LogLimiter()
        self._unread_bytes = 0

    async def answer(self, request: Request, send: Callable[[Response], Awaitable[None]]) -> None:
        """Answer a request that asks for no WebSocket; ``send`` returns when the client has read the response."""
        methods = ("POST",) if _name(request.path) in self._post_routes else METHODS
        if request.method not in methods:
            text = f"{request.method[:20]} is not for this address, but {' and '.join(methods)}"
            answer = HttpResponse.of_text(HTTPStatus.METHOD_NOT_ALLOWED, text, {"Allow": ", ".join(methods)})
        else:
            answer = await self._answer(request)
        if answer.status >= HTTPStatus.BAD_REQUEST:
            # Behind the question mark there may be a token.
            asked = one_line(shorten(request.path.partition("?")[0]))
            log.debug("%s %s: %d", request.method[:20], asked, answer.status)
        response = answer.response(request)
        # Routes are small, and health must be answered while others read files.
        is_route = _name(request.path) in self._routes
        if not is_route and self._unread_bytes + len(response.body) > MAX_UNREAD_BYTES:
            text = f"clients leave {self._unread_bytes} bytes unread, the limit is {MAX_UNREAD_BYTES}; ask again later"
            refused = HttpResponse.of_text(HTTPStatus.SERVICE_UNAVAILABLE, text, {"Retry-After": "5"})
            await send(refused.response(request))
            return
        self._unread_bytes += len(response.body)
        try:
            await send(response)
        finally:
            self._unread_bytes -= len(response.body)

    def body_bytes(self, request: Request) -> int | HttpResponse | None:
        """Return the size of a posted request's body; a response to refuse it with; None for any other request."""
        if request.method != "POST" or _name(request.path) not in self._post_routes:
            return None
        headers = request.headers
        named = headers.get_all("Content-Type")
        media_type = named[0].partition(";")[0].strip().lower() if len(named) == 1 else ""
        if media_type != BODY_TYPE:
            sentence = (
                f"the header Content-Type must be {BODY_TYPE}, not {one_line(shorten(', '.join(named) or 'none'))}"
            )
            return HttpResponse.of_failure(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, sentence)
        lengths = headers.get_all("Content-Length")
        in_parts = headers.get_all("Transfer-Encoding")
        if in_parts or len(lengths) != 1 or not _LENGTH.fullmatch(lengths[0]):
            got = one_line(shorten(", ".join(lengths) or "none"))
            sentence = f"the header Content-Length must be one number, without Transfer-Encoding, not {got}"
            # RFC 9112, 6.3: a length that is no number is a bad request.
            status = HTTPStatus.LENGTH_REQUIRED if in_parts or not lengths else HTTPStatus.BAD_REQUEST
            return HttpResponse.of_failure(status, sentence)
        if int(lengths[0]) > MAX_BODY_BYTES:
            sentence = f"the body has {int(lengths[0])} bytes, the limit is {MAX_BODY_BYTES}"
            return HttpResponse.of_failure(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, sentence)
        return int(lengths[0])

    async def answer_posted(self, posted: PostedRequest) -> HttpResponse:
        """Return the answer to a request whose :meth:`body_bytes` are there."""
        name = _name(posted.request.path)
        return await self._post_routes[name or ""](posted)

    async def _answer(self, request: Request) -> HttpResponse:
        name = _name(request.path)
        if name is None:
            return HttpResponse.of_text(HTTPStatus.NOT_FOUND, "this is no path to a file")
        if name in self._routes:
            return await self._routes[name](request)
        gzipped = names(request.headers, "Accept-Encoding", "gzip") and PurePath(name).suffix.lower() not in _COMPRESSED
        area, _, inner = name.partition("/")
        try:
            if area == ROBOT:
                return await self._robot_file(inner, gzipped)
            if area == DOCS:
                return await self._docs_file(inner, gzipped)
            return await self._page_file(name, gzipped)
        except FileTooLargeError as error:
            self._log_unserved(_sentence(error))
            return HttpResponse.of_text(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, _sentence(error), _cors(area))
        except ServiceError as error:
            return HttpResponse.of_text(HTTPStatus.NOT_FOUND, _sentence(error), _cors(area))
        except OSError as error:
            self._log_unserved(f"{name!r} cannot be read: {error.strerror}")
            return HttpResponse.of_text(HTTPStatus.INTERNAL_SERVER_ERROR, f"{name!r} cannot be read", _cors(area))

    async def _page_file(self, name: str, gzipped: bool) -> HttpResponse:
        if name in ("", INDEX) and not page_is_built(self._page_directory):
            return HttpResponse.of_text(HTTPStatus.NOT_FOUND, f"armbridge is running; {HOW_TO_BUILD_PAGE}")
        file = await self._page_files.read(lambda: find_page_file(self._page_directory, name), gzipped=gzipped)
        keeping = _FOR_EVER if _HASHED.fullmatch(name) else _ASK_AGAIN
        return HttpResponse.of_file(file, media_type(name or INDEX), keeping, {"Content-Security-Policy": self._policy})

    async def _docs_file(self, name: str, gzipped: bool) -> HttpResponse:
        if not page_is_built(self._docs_directory):
            raise ServiceError("the docs are not built: call make docs")
        if not name:
            # The links of the index begin at its folder.
            return HttpResponse.of_text(HTTPStatus.PERMANENT_REDIRECT, "docs/", {"Location": f"{DOCS}/"})
        file = await self._page_files.read(lambda: find_page_file(self._docs_directory, name), gzipped=gzipped)
        return HttpResponse.of_file(file, media_type(name), _ASK_AGAIN)

    async def _robot_file(self, name: str, gzipped: bool) -> HttpResponse:
        text = self._descriptions.get(name)
        if text is not None:
            file = StoredFile.of(text, gzipped=gzipped)
        elif (files := self._files) is None:
            raise ServiceError("there is no robot")
        else:
            url = f"package://{name}"
            file = await self._robot_files.read(lambda: files.find(url), gzipped=gzipped)
        return HttpResponse.of_file(file, media_type(name), _ASK_AGAIN, _cors(ROBOT))

    def _log_unserved(self, sentence: str) -> None:
        self._log.write(log, logging.WARNING, f"not served: {sentence}", sentence)


def _sentence(error: ServiceError) -> str:
    """Return the sentence of an error, without the field of the service that serves the same files."""
    return str(error).removeprefix("name: ")


def _name(path: str) -> str | None:
    try:
        name = unquote(path.partition("?")[0], errors="strict")
    except ValueError:
        return None
    if not name.startswith("/"):
        return None
    if name == f"/{DOCS}/":
        name += INDEX
    parts = name[1:].split("/")
    if parts != [""] and any(part in ("", ".", "..") for part in parts):
        return None
    return name[1:]


def _cors(area: str) -> dict[str, str]:
    """Return the headers that let pages of any origin, such as Foxglove's, read the robot's files and nothing else."""
    return {"Access-Control-Allow-Origin": "*", "Cross-Origin-Resource-Policy": "cross-origin"} if area == ROBOT else {}
