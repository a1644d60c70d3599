"""HTTP on the port of rosbridge: the page at ``/``, the robot's files below ``/robot/``, and routes.

One request a connection, answered before there is a WebSocket; requests to upgrade pass, whatever they ask for.
"""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Awaitable, Callable, Mapping
from http import HTTPStatus
from pathlib import Path
from typing import TypeAlias
from urllib.parse import unquote

from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from protocol.errors import one_line, shorten
from robot.description.model import RobotModel
from server.errors import FileTooLargeError, ServiceError
from server.gateway import page
from server.gateway.file_cache import FileCache, StoredFile
from server.gateway.http_answers import Answer, accepts_gzip, names
from server.gateway.media_types import compressible, media_type
from server.moveit.description import find_file, package_name, with_package_urls

log = logging.getLogger("armbridge.gateway")

# Answers a request for one path.
Route: TypeAlias = Callable[[Request], Awaitable[Answer]]

METHODS = ("GET", "HEAD")

# Files that the log is told of; whoever has more of them knows by then.
MAX_TOLD = 100

# What clients may leave unread in all. The meshes of an arm, to a dozen browsers at a time.
MAX_UNREAD_BYTES = 256 << 20

ROBOT = "robot"
DESCRIPTIONS = ("description.urdf", "description.srdf")

# As vite names what it builds with a hash of the content: such a file never changes.
_HASHED = re.compile(r"assets/[^/]+-[A-Za-z0-9_-]{8}\.[a-z0-9.]+")
_FOR_EVER = "public, max-age=31536000, immutable"

# Kept by the browser, and asked about at each use: an ETag that still holds costs 300 bytes.
_ASK_AGAIN = "no-cache"


class HttpGate:
    """Answers what is asked over HTTP.

    Args:
        robot: whose files are served.
        page_directory: the built page; it may come, go and change while the server runs.
        routes: what else is answered, by path without its first slash; they come before the page's files.
    """

    def __init__(
        self,
        robot: RobotModel | None = None,
        page_directory: Path = page.PAGE_DIRECTORY,
        routes: Mapping[str, Route] | None = None,
    ) -> None:
        self._robot = robot
        self._routes = routes or {}
        self._page_directory = page_directory
        # Large meshes do not put the page out, nor does their disk hold it up.
        self._page_files = FileCache()
        self._robot_files = FileCache()
        self._descriptions = _descriptions(robot) if robot else {}
        self._told: set[str] = set()
        self._unread_bytes = 0
        self._readers: set[asyncio.Task[None]] = set()

    async def process_request(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request; None for one that wants to become a WebSocket."""
        if names(request.headers, "Upgrade", "websocket"):
            return None
        if request.method not in METHODS:
            text = f"{request.method[:20]} is not for this address: {' and '.join(METHODS)} are"
            answer = Answer.of_text(HTTPStatus.METHOD_NOT_ALLOWED, text, {"Allow": ", ".join(METHODS)})
        else:
            answer = await self._answer(request)
        if answer.status >= HTTPStatus.BAD_REQUEST:
            # Behind the question mark there may be a token.
            asked = one_line(shorten(request.path.partition("?")[0]))
            log.debug("%s %s: %d", request.method[:20], asked, answer.status)
        response = answer.response(request)
        # Routes are small, and whether the server lives is to be heard while others read files.
        is_route = _name(request.path) in self._routes
        if not is_route and self._unread_bytes + len(response.body) > MAX_UNREAD_BYTES:
            text = f"clients leave {self._unread_bytes} bytes unread, the limit is {MAX_UNREAD_BYTES}; ask again later"
            return Answer.of_text(HTTPStatus.SERVICE_UNAVAILABLE, text, {"Retry-After": "5"}).response(request)
        self._count(connection, len(response.body))
        return response

    def _count(self, connection: ServerConnection, size_bytes: int) -> None:
        """Count what is sent as unread until the connection has ended."""

        def read(reader: asyncio.Task[None]) -> None:
            self._readers.discard(reader)
            self._unread_bytes -= size_bytes

        self._unread_bytes += size_bytes
        # The event loop keeps no task by itself.
        reader = asyncio.create_task(connection.wait_closed())
        self._readers.add(reader)
        reader.add_done_callback(read)

    async def _answer(self, request: Request) -> Answer:
        name = _name(request.path)
        if name is None:
            return Answer.of_text(HTTPStatus.NOT_FOUND, "this is no path to a file")
        if name in self._routes:
            return await self._routes[name](request)
        gzipped = accepts_gzip(request.headers) and compressible(name or page.INDEX)
        room, _, inner = name.partition("/")
        try:
            if room == ROBOT:
                return await self._robot_file(inner, gzipped)
            return await self._page_file(name, gzipped)
        except FileTooLargeError as error:
            self._tell_once(_sentence(error))
            return Answer.of_text(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, _sentence(error), _cors(room))
        except ServiceError as error:
            return Answer.of_text(HTTPStatus.NOT_FOUND, _sentence(error), _cors(room))
        except OSError as error:
            self._tell_once(f"{name!r} cannot be read: {error.strerror}")
            return Answer.of_text(HTTPStatus.INTERNAL_SERVER_ERROR, f"{name!r} cannot be read", _cors(room))

    async def _page_file(self, name: str, gzipped: bool) -> Answer:
        if name in ("", page.INDEX) and not page.is_built(self._page_directory):
            return Answer.of_html(HTTPStatus.NOT_FOUND, page.NOT_BUILT)
        file = await self._page_files.read(lambda: page.find_page_file(self._page_directory, name), gzipped=gzipped)
        keeping = _FOR_EVER if _HASHED.fullmatch(name) else _ASK_AGAIN
        return Answer.of_file(file, media_type(name or page.INDEX), keeping)

    async def _robot_file(self, name: str, gzipped: bool) -> Answer:
        text = self._descriptions.get(name)
        if text is not None:
            file = StoredFile.of(text, gzipped=gzipped)
        elif self._robot is None:
            raise ServiceError("there is no robot")
        else:
            directory, package = self._robot.mesh_directory, package_name(self._robot)
            url = f"package://{name}"
            file = await self._robot_files.read(lambda: find_file(directory, package, url), gzipped=gzipped)
        return Answer.of_file(file, media_type(name), _ASK_AGAIN, _cors(ROBOT))

    def _tell_once(self, sentence: str) -> None:
        """Warn of a file; a browser that asks for it again and again tells nothing new."""
        if sentence not in self._told and len(self._told) < MAX_TOLD:
            self._told.add(sentence)
            log.warning("not served: %s", sentence)


def _sentence(error: ServiceError) -> str:
    """What there is to say, without the field of the service that the same files are served by."""
    return str(error).removeprefix("name: ")


def _name(path: str) -> str | None:
    """The path that is asked for without its first slash, None when it names no file for certain."""
    try:
        name = unquote(path.partition("?")[0], errors="strict")
    except ValueError:
        return None
    if not name.startswith("/"):
        return None
    parts = name[1:].split("/")
    if parts != [""] and any(part in ("", ".", "..") for part in parts):
        return None
    return name[1:]


def _descriptions(robot: RobotModel) -> dict[str, bytes]:
    texts = (with_package_urls(robot.urdf, package_name(robot)), robot.srdf)
    return dict(zip(DESCRIPTIONS, (text.encode() for text in texts), strict=True))


def _cors(room: str) -> dict[str, str]:
    """The robot's files may be read by pages of any origin, as Foxglove's; the page itself is for nobody else."""
    return {"Access-Control-Allow-Origin": "*", "Cross-Origin-Resource-Policy": "cross-origin"} if room == ROBOT else {}
