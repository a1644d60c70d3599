import asyncio
import contextlib
import gzip
import http.client
import logging
import os
import re
import socket
import threading
from collections.abc import AsyncIterator, Mapping
from dataclasses import replace
from http import HTTPStatus
from pathlib import Path
from types import MappingProxyType

import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request

from harness.waiting import TIMEOUT_S
from server import robot_files
from server.errors import ServiceError
from server.gateway import http as gate
from server.gateway.http import FileCache, HttpHandler, HttpResponse, StoredFile
from tests.helpers.gateway import listening
from tests.helpers.robots import so101

PACKAGE = "so101_description"
MESH = b"solid " + b"0.123 " * 1000
SCRIPT = b"export const answer = 42;\n" * 100
PAGE_FILES = ("/", "/assets/vendor.js", "/assets/index-Bx3_-9aQ.js")

MESH_LINK = '<link name="extra"><visual><geometry><mesh filename="assets/base.stl"/></geometry></visual></link>'
URDF = so101().urdf.replace("</robot>", f"{MESH_LINK}</robot>")


@pytest.fixture
def folders(tmp_path: Path) -> Path:
    """A built page, a robot, and what lies beside them and is nobody's business."""
    page, robot = tmp_path / "dist" / "assets", tmp_path / "robot" / "assets"
    for folder in (page, robot):
        folder.mkdir(parents=True)
    for name in ("secret.js", "secret.stl"):
        (tmp_path / name).write_text("key")
    (page.parent / "index.html").write_text("<!doctype html><title>the page</title>")
    for name in ("vendor.js", "index-Bx3_-9aQ.js"):
        (page / name).write_bytes(SCRIPT)
    (page / "out.js").symlink_to(tmp_path / "secret.js")
    (robot / "base.stl").write_bytes(MESH)
    (robot / "out.stl").symlink_to(tmp_path / "secret.stl")
    return tmp_path


class Site:
    """The listener as a browser sees it."""

    def __init__(self, port: int) -> None:
        self.port = port

    async def ask(
        self, path: str, method: str = "GET", headers: Mapping[str, str] = MappingProxyType({})
    ) -> tuple[http.client.HTTPResponse, bytes]:
        return await asyncio.to_thread(self._ask, path, method, headers)

    def _ask(self, path: str, method: str, headers: Mapping[str, str]) -> tuple[http.client.HTTPResponse, bytes]:
        with contextlib.closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=TIMEOUT_S)) as connection:
            # To the letter: a client that means harm does not tidy its paths.
            connection.putrequest(method, path, skip_accept_encoding=True)
            for name, value in headers.items():
                connection.putheader(name, value)
            connection.endheaders()
            response = connection.getresponse()
            return response, response.read()


async def live(_request: Request) -> HttpResponse:
    return HttpResponse.of_data(HTTPStatus.OK, b"yes", "text/plain")


@contextlib.asynccontextmanager
async def site_of(folders: Path) -> AsyncIterator[Site]:
    robot = replace(so101(), urdf=URDF, mesh_directory=folders / "robot")
    async with listening(http=HttpHandler(robot, folders / "dist", {"livez": live})) as listener:
        yield Site(listener.port)


@pytest.fixture
async def site(folders: Path) -> AsyncIterator[Site]:
    async with site_of(folders) as made:
        yield made


async def test_each_file_has_the_content_type_of_its_kind(site: Site) -> None:
    for kind, paths in {
        "text/html; charset=utf-8": ("/", "/?x=1", "/index.html"),
        "text/javascript; charset=utf-8": ("/assets/vendor.js",),
        "application/xml; charset=utf-8": ("/robot/description.urdf", "/robot/description.srdf"),
        "model/stl": (f"/robot/{PACKAGE}/assets/base.stl", f"/robot/{PACKAGE}/assets/b%61se.stl"),
    }.items():
        for path in paths:
            got, body = await site.ask(path)
            assert (got.status, got.headers["Content-Type"]) == (200, kind), path
            assert int(got.headers["Content-Length"]) == len(body) > 0, path
            head, nothing = await site.ask(path, "HEAD")
            assert (head.status, nothing) == (200, b""), path
            assert {**head.headers, "Date": ""} == {**got.headers, "Date": ""}, path


async def test_a_route_is_asked_before_the_page_and_for_its_own_path_alone(folders: Path) -> None:
    async def answer(request: Request) -> HttpResponse:
        return HttpResponse.of_data(HTTPStatus.OK, request.path.encode(), "text/x-path")

    gate_with_routes = HttpHandler(None, folders / "dist", {"index.html": answer, "healthz": answer})
    asked = [Request(path, Headers()) for path in ("/index.html", "/healthz?verbose", "/healthz/x", "/")]
    answers = [await gate_with_routes._answer(request) for request in asked]
    assert [each.body for each in answers[:2]] == [b"/index.html", b"/healthz?verbose"]
    assert [each.headers["Content-Type"] == "text/x-path" for each in answers] == [True, True, False, False]


async def test_the_page_may_ask_no_other_host_and_be_in_no_other_page(site: Site) -> None:
    kept = {"X-Content-Type-Options": "nosniff", "X-Frame-Options": "DENY", "Referrer-Policy": "no-referrer"}
    for path in ("/", "/assets/vendor.js", "/nothing"):
        got, _ = await site.ask(path)
        stated = got.headers["Content-Security-Policy"]
        policy = dict(part.split(" ", 1) for part in stated.split("; "))
        assert policy["default-src"] == policy["frame-ancestors"] == policy["base-uri"] == "'none'"
        assert policy["script-src"] == policy["style-src"] == "'self'"
        assert not re.search("http|unsafe", stated)
        assert {**got.headers, **kept, "Connection": "close"} == dict(got.headers)


async def test_a_compressed_file_is_smaller_and_has_the_same_content(site: Site) -> None:
    for path, content in (("/assets/vendor.js", SCRIPT), (f"/robot/{PACKAGE}/assets/base.stl", MESH)):
        plain, body = await site.ask(path)
        assert (plain.headers["Content-Encoding"], body) == (None, content)
        smaller, packed = await site.ask(path, headers={"Accept-Encoding": "br, gzip"})
        assert smaller.headers["Content-Encoding"] == "gzip"
        assert smaller.headers["Vary"] == "Accept-Encoding"
        assert (gzip.decompress(packed), len(packed) < len(content)) == (content, True)
        assert smaller.headers["ETag"] != plain.headers["ETag"]


async def test_a_cached_file_is_not_sent_again_until_it_changes_nor_asked_for_with_its_content_in_its_name(
    site: Site, folders: Path
) -> None:
    kept = {path: (await site.ask(path))[0].headers["Cache-Control"] for path in PAGE_FILES}
    assert [path for path, policy in kept.items() if "immutable" in policy] == ["/assets/index-Bx3_-9aQ.js"]
    assert kept["/"] == kept["/assets/vendor.js"] == "no-cache"
    got, _ = await site.ask("/assets/vendor.js")
    has = {"If-None-Match": f'"other", W/{got.headers["ETag"]}'}
    again, nothing = await site.ask("/assets/vendor.js", headers=has)
    assert (again.status, nothing, again.headers["ETag"]) == (304, b"", got.headers["ETag"])
    (folders / "dist" / "assets" / "vendor.js").write_bytes(SCRIPT + b"//")
    changed, body = await site.ask("/assets/vendor.js", headers=has)
    assert (changed.status, body) == (200, SCRIPT + b"//")


async def test_other_methods_are_refused_with_those_that_there_are(site: Site) -> None:
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "TRACE", "X"):
        got, body = await site.ask("/", method)
        assert (got.status, got.headers["Allow"]) == (405, "GET, HEAD")
        assert method.encode() in body


ABOVE = ("/../secret.js", "/%2e%2e/secret.js", "/..%2fsecret.js", "/assets/../../secret.js", "//127.0.0.1/secret.js")
NO_FILES = ("/nothing", "/assets", "/assets/", "//", "/assets/out.js", "/assets//vendor.js", "/./index.html")
NO_PATHS = ("/%00", "/%ff", "//x/index.html", "http://127.0.0.1/index.html", "index.html", f"/{'a' * 5000}")
NO_ROBOT = ("", "/", "/description.txt", f"/{PACKAGE}", "/other/assets/base.stl", f"/{PACKAGE}/assets/out.stl")
ABOVE_ROBOT = ("../../secret.stl", "%2e%2e/secret.stl", "..%2fsecret.stl", "/etc/hosts", "%2fetc/hosts")


async def test_nothing_else_is_there(site: Site) -> None:
    of_robot = [f"/robot{path}" for path in (*NO_ROBOT, *(f"/{PACKAGE}/{path}" for path in ABOVE_ROBOT))]
    for path in (*ABOVE, *NO_FILES, *NO_PATHS, *of_robot):
        got, body = await site.ask(path)
        assert (got.status, got.headers["Content-Type"]) == (404, "text/plain; charset=utf-8"), path
        assert body.endswith(b"\n"), path
        assert b"key" not in body, path


async def test_a_robot_s_files_may_be_read_by_pages_of_other_origins_and_the_page_may_not(site: Site) -> None:
    robot = ("/robot/description.urdf", f"/robot/{PACKAGE}/assets/base.stl", "/robot/nothing")
    for path, origins in {**dict.fromkeys(robot, "*"), "/": None}.items():
        assert (await site.ask(path))[0].headers["Access-Control-Allow-Origin"] == origins


async def test_a_file_that_is_too_large_is_told_once_with_the_limit(
    site: Site, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(robot_files, "MAX_FILE_BYTES", 4)
    monkeypatch.setattr(gate, "MAX_PAGE_FILE_BYTES", 3)
    mesh = f"'package://{PACKAGE}/assets/base.stl' has {len(MESH)} bytes, the limit is 4"
    for path, sentence in ((f"/robot/{PACKAGE}/assets/base.stl", mesh), ("/assets/vendor.js", "bytes, the limit is 3")):
        for _ in range(2):
            got, body = await site.ask(path)
            assert got.status == 413, path
            assert sentence.encode() in body
        assert caplog.text.count(sentence) == 1


async def test_a_file_that_cannot_be_read_is_an_error_of_the_server(
    site: Site, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(self: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", broken)
    assert (await site.ask("/assets/vendor.js"))[0].status == 500
    assert "'assets/vendor.js' cannot be read: Permission denied" in caplog.text


async def test_without_a_page_it_says_how_to_get_it_and_finds_it_once_it_is_there(site: Site, folders: Path) -> None:
    (folders / "dist").rename(folders / "elsewhere")
    got, body = await site.ask("/")
    assert (got.status, got.headers["Content-Type"]) == (404, "text/plain; charset=utf-8")
    assert gate.HOW_TO_BUILD_PAGE.encode() in body
    (folders / "elsewhere").rename(folders / "dist")
    assert (await site.ask("/"))[0].status == 200


async def test_the_docs_are_served_below_their_folder_once_they_are_built(tmp_path: Path) -> None:
    (tmp_path / "secret.js").write_text("key")
    handler = HttpHandler(page_directory=tmp_path / "page", docs_directory=tmp_path / "docs")
    async with listening(http=handler) as listener:
        site = Site(listener.port)
        missing, sentence = await site.ask("/docs/")
        assert (missing.status, b"call make docs" in sentence) == (404, True)
        (tmp_path / "docs").mkdir()
        (tmp_path / "docs" / "index.html").write_text("<!doctype html><title>docs</title>")
        moved, _ = await site.ask("/docs")
        assert (moved.status, moved.headers["Location"]) == (308, "docs/")
        assert (await site.ask("/docs/"))[1] == (await site.ask("/docs/index.html"))[1]
        for outside in ("/docs/other.html", "/docs//", "/docs/../secret.js", "/docs/%2e%2e/secret.js"):
            assert (await site.ask(outside))[0].status == 404


async def test_a_robot_without_files_has_its_description_and_no_robot_nothing() -> None:
    answer = await HttpHandler(so101())._robot_file("description.urdf", gzipped=False)
    assert answer.body == so101().urdf.encode()
    with pytest.raises(ServiceError, match="no robot"):
        await HttpHandler()._robot_file("description.urdf", gzipped=False)


async def test_the_log_is_silent_about_pages_that_load(site: Site, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    for path in ("/", "/assets/vendor.js", "/nothing"):
        await site.ask(path)
    assert not [record for record in caplog.records if "HTTP" in record.message or "rejected" in record.message]
    caplog.set_level(logging.DEBUG, "armbridge")
    await site.ask("/nothing")
    assert [record.levelname for record in caplog.records if record.message == "GET /nothing: 404"] == ["DEBUG"]


async def test_a_client_that_reads_slowly_gets_all(folders: Path) -> None:
    octets = bytes(range(256)) * (1 << 15)
    (folders / "robot" / "assets" / "large.stl").write_bytes(octets)

    def read_slowly(port: int) -> bytes:
        with socket.socket() as client:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            client.connect(("127.0.0.1", port))
            client.sendall(f"GET /robot/{PACKAGE}/assets/large.stl HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
            got = bytearray()
            while part := client.recv(1 << 20):
                got += part
        return bytes(got)

    async with site_of(folders) as site:
        got = await asyncio.to_thread(read_slowly, site.port)
    assert got.partition(b"\r\n\r\n")[2] == octets


async def test_unread_answers_take_bounded_memory(site: Site, folders: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = f"/robot/{PACKAGE}/assets/large.stl"
    (folders / "robot" / "assets" / "large.stl").write_bytes(bytes(16 << 20))
    monkeypatch.setattr(gate, "MAX_UNREAD_BYTES", 20 << 20)
    with socket.create_connection(("127.0.0.1", site.port)) as deaf:
        deaf.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        await asyncio.to_thread(deaf.recv, 1)
        refused, body = await site.ask(path)
        assert (refused.status, refused.headers["Retry-After"]) == (503, "5")
        assert f"clients leave {16 << 20} bytes unread, the limit is {20 << 20}".encode() in body
        assert (await site.ask("/"))[0].status == 200
        # Whether the server lives is asked by whoever starts it anew when it does not say so.
        monkeypatch.setattr(gate, "MAX_UNREAD_BYTES", 0)
        assert [(await site.ask(each))[0].status for each in ("/livez", "/")] == [200, 503]
        monkeypatch.setattr(gate, "MAX_UNREAD_BYTES", 20 << 20)
    async with asyncio.timeout(TIMEOUT_S):
        # The end of the deaf client's connection is not ordered with the next request.
        while (await site.ask(path))[0].status != 200:
            pass


def test_a_header_may_come_in_several_lines() -> None:
    headers = Headers([("Connection", "keep-alive"), ("Upgrade", "h2c"), ("Upgrade", "foo, WebSocket")])
    assert gate.names(headers, "Upgrade", "websocket")
    assert not gate.names(headers, "Upgrade", "socket")
    assert gate.names(Headers({"Accept-Encoding": "br, GZIP;q=0.5"}), "Accept-Encoding", "gzip")


def test_content_that_is_there_already_is_not_sent_and_a_sentence_has_no_name() -> None:
    answer = HttpResponse.of_file(StoredFile(b"content", '"name"', gzipped=True), "text/css", "no-cache")
    for held in ('"name"', 'W/"name"', '"a", "name"', "*"):
        sent = answer.response(Request("/", Headers({"If-None-Match": held})))
        assert (sent.status_code, sent.body, sent.headers["ETag"]) == (HTTPStatus.NOT_MODIFIED, b"", '"name"'), held
        assert not {"Content-Type", "Content-Encoding", "Content-Length"} & set(sent.headers), held
    answer = HttpResponse.of_text(HTTPStatus.NOT_FOUND, "no \udcff")
    sent = answer.response(Request("/", Headers({"If-None-Match": "*"})))
    assert (sent.status_code, sent.body, sent.headers["Cache-Control"]) == (404, b"no \\udcff\n", "no-store")
    assert answer.response(Request("/", Headers(), "HEAD")).headers["Content-Length"] == "10"


LONG = b"0123456789" * 1000


def test_a_file_that_gzip_makes_no_smaller_stays_as_it_is() -> None:
    for octets in (b"short", os.urandom(5000)):
        assert StoredFile.of(octets, gzipped=True) == StoredFile.of(octets, gzipped=False)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A long file."""
    (tmp_path / "file").write_bytes(LONG)
    return tmp_path / "file"


async def test_a_file_is_read_once_until_it_changes(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache, reads = FileCache(), []
    read_bytes = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda self: reads.append(self) or read_bytes(self))
    first = await cache.read(lambda: path, gzipped=True)
    assert await cache.read(lambda: path, gzipped=True) is first
    assert len(reads) == 1
    await asyncio.to_thread(path.write_bytes, LONG + b".")
    assert (await cache.read(lambda: path, gzipped=False)).octets == LONG + b"."


async def test_the_file_asked_for_the_longest_ago_goes_first_and_one_too_large_is_not_kept(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in "abc"]
    for path in paths:
        path.write_bytes(LONG)
    a, b, c = paths
    cache = FileCache(2 * len(LONG))
    kept = {path: await cache.read(lambda path=path: path, gzipped=False) for path in (a, b)}  # type: ignore[misc]
    assert await cache.read(lambda: a, gzipped=False) is kept[a]
    await cache.read(lambda: c, gzipped=False)
    assert await cache.read(lambda: a, gzipped=False) is kept[a]
    assert await cache.read(lambda: b, gzipped=False) is not kept[b]
    cache = FileCache(len(LONG) - 1)
    first = await cache.read(lambda: a, gzipped=False)
    assert first.octets == LONG
    assert await cache.read(lambda: a, gzipped=False) is not first


async def test_files_are_read_by_one_thread_beside_the_event_loop(path: Path) -> None:
    at_work: list[int] = []

    def find() -> Path:
        assert threading.current_thread() is not threading.main_thread()
        at_work.append(1)
        assert len(at_work) == 1
        at_work.pop()
        return path

    cache = FileCache()
    await asyncio.gather(*(cache.read(find, gzipped=True) for _ in range(5)))


def test_a_file_is_what_its_name_ends_in() -> None:
    text, unknown = "text/{}; charset=utf-8", "application/octet-stream"
    kinds = {"index.html": text.format("html"), "a/b.MJS": text.format("javascript"), "style.css": text.format("css")}
    kinds |= {"icon.svg": "image/svg+xml; charset=utf-8", "base.DAE": "model/vnd.collada+xml; charset=utf-8"}
    kinds |= {"base.stl": "model/stl", "texture.png": "image/png", "file": unknown, ".html": unknown, "x.exe": unknown}
    assert {name: gate.media_type(name) for name in kinds} == kinds
