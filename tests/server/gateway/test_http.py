from __future__ import annotations

import asyncio
import gzip
import http.client
import logging
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from http import HTTPStatus
from pathlib import Path
from urllib.parse import urljoin
from urllib.request import urlopen

import pytest
from websockets.asyncio.client import connect
from websockets.datastructures import Headers
from websockets.http11 import Request

from protocol.registry import Registry
from robot import model
from server.errors import ServiceError
from server.gateway import http as gate
from server.gateway import page
from server.gateway.http import HttpGate
from server.gateway.http_answers import Answer
from server.gateway.listener import OPEN_TIMEOUT_S, Listener
from server.graph import Graph
from server.moveit import robot_files

REGISTRY = Registry.load()
PACKAGE = "so101_description"
MESH = b"solid " + b"0.123 " * 1000
SCRIPT = b"export const answer = 42;\n" * 100

MESH_LINK = '<link name="extra"><visual><geometry><mesh filename="assets/base.stl"/></geometry></visual></link>'
URDF = model.builtin().urdf.replace("</robot>", f"{MESH_LINK}</robot>")


@pytest.fixture
def folders(tmp_path: Path) -> Path:
    """A built page, a robot, and what lies beside them and is nobody's business."""
    (tmp_path / "secret.js").write_text("key")
    (tmp_path / "secret.stl").write_text("key")
    built = tmp_path / "dist"
    (built / "assets").mkdir(parents=True)
    (built / "index.html").write_text("<!doctype html><title>the page</title>")
    (built / "assets" / "vendor.js").write_bytes(SCRIPT)
    (built / "assets" / "index-Bx3_-9aQ.js").write_bytes(SCRIPT)
    (built / "assets" / "out.js").symlink_to(tmp_path / "secret.js")
    robot = tmp_path / "robot"
    (robot / "assets").mkdir(parents=True)
    (robot / "assets" / "base.stl").write_bytes(MESH)
    (robot / "assets" / "out.stl").symlink_to(tmp_path / "secret.stl")
    return tmp_path


class Site:
    """The listener as a browser sees it."""

    def __init__(self, port: int) -> None:
        self.port = port

    async def ask(
        self, path: str, method: str = "GET", headers: dict[str, str] | None = None
    ) -> tuple[http.client.HTTPResponse, bytes]:
        return await asyncio.to_thread(self._ask, path, method, headers or {})

    def _ask(self, path: str, method: str, headers: dict[str, str]) -> tuple[http.client.HTTPResponse, bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30.0)
        try:
            # To the letter: a client that means harm does not tidy its paths.
            connection.putrequest(method, path, skip_accept_encoding=True)
            for name, value in headers.items():
                connection.putheader(name, value)
            connection.endheaders()
            response = connection.getresponse()
            return response, response.read()
        finally:
            connection.close()


async def live(_request: Request) -> Answer:
    return Answer.of_data(HTTPStatus.OK, b"yes", "text/plain")


@asynccontextmanager
async def site_of(folders: Path) -> AsyncIterator[Site]:
    robot = replace(model.builtin(), urdf=URDF, mesh_directory=folders / "robot")
    listener = Listener(Graph(REGISTRY), "127.0.0.1", 0, HttpGate(robot, folders / "dist", {"livez": live}))
    await listener.bind()
    await listener.open()
    yield Site(listener.port)
    await listener.close()


@pytest.fixture
async def site(folders: Path) -> AsyncIterator[Site]:
    async with site_of(folders) as made:
        yield made


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/", "text/html; charset=utf-8"),
        ("/?x=1", "text/html; charset=utf-8"),
        ("/index.html", "text/html; charset=utf-8"),
        ("/assets/vendor.js", "text/javascript; charset=utf-8"),
        ("/robot/description.urdf", "application/xml; charset=utf-8"),
        ("/robot/description.srdf", "application/xml; charset=utf-8"),
        (f"/robot/{PACKAGE}/assets/base.stl", "model/stl"),
        (f"/robot/{PACKAGE}/assets/b%61se.stl", "model/stl"),
    ],
)
async def test_a_file_is_there_as_what_it_is(site: Site, path: str, kind: str) -> None:
    got, body = await site.ask(path)
    assert (got.status, got.headers["Content-Type"]) == (200, kind)
    assert int(got.headers["Content-Length"]) == len(body) > 0
    head, nothing = await site.ask(path, "HEAD")
    assert (head.status, nothing) == (200, b"")
    assert {**head.headers, "Date": ""} == {**got.headers, "Date": ""}


async def test_a_route_is_asked_before_the_page_and_for_its_own_path_alone(folders: Path) -> None:
    async def answer(request: Request) -> Answer:
        return Answer.of_data(HTTPStatus.OK, request.path.encode(), "text/x-path")

    gate_with_routes = HttpGate(None, folders / "dist", {"index.html": answer, "healthz": answer})
    asked = [Request(path, Headers()) for path in ("/index.html", "/healthz?verbose", "/healthz/x", "/")]
    answers = [await gate_with_routes._answer(request) for request in asked]
    assert [each.body for each in answers[:2]] == [b"/index.html", b"/healthz?verbose"]
    assert [each.headers["Content-Type"] == "text/x-path" for each in answers] == [True, True, False, False]


async def test_what_stands_behind_the_question_mark_is_not_logged(site: Site, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG, "armbridge.gateway")
    await site.ask("/nothing?token=s3cret")
    assert "/nothing: 404" in caplog.text
    assert "s3cret" not in caplog.text


async def test_the_page_may_ask_no_other_host_and_be_in_no_other_page(site: Site) -> None:
    for path in ("/", "/assets/vendor.js", "/nothing"):
        got, _ = await site.ask(path)
        policy = dict(part.split(" ", 1) for part in got.headers["Content-Security-Policy"].split("; "))
        assert policy["default-src"] == policy["frame-ancestors"] == policy["base-uri"] == "'none'"
        assert policy["script-src"] == policy["style-src"] == "'self'"
        assert "http" not in got.headers["Content-Security-Policy"]
        assert "unsafe" not in got.headers["Content-Security-Policy"]
        assert got.headers["X-Content-Type-Options"] == "nosniff"
        assert got.headers["X-Frame-Options"] == "DENY"
        assert got.headers["Referrer-Policy"] == "no-referrer"
        assert got.headers["Connection"] == "close"


async def test_what_is_compressed_is_smaller_and_the_same(site: Site) -> None:
    for path, content in (("/assets/vendor.js", SCRIPT), (f"/robot/{PACKAGE}/assets/base.stl", MESH)):
        plain, body = await site.ask(path)
        assert (plain.headers["Content-Encoding"], body) == (None, content)
        smaller, packed = await site.ask(path, headers={"Accept-Encoding": "br, gzip"})
        assert smaller.headers["Content-Encoding"] == "gzip"
        assert smaller.headers["Vary"] == "Accept-Encoding"
        assert (gzip.decompress(packed), len(packed) < len(content)) == (content, True)
        assert smaller.headers["ETag"] != plain.headers["ETag"]


async def test_what_a_browser_has_is_not_sent_again_until_it_changes(site: Site, folders: Path) -> None:
    got, _ = await site.ask("/assets/vendor.js")
    has = {"If-None-Match": f'"other", W/{got.headers["ETag"]}'}
    again, nothing = await site.ask("/assets/vendor.js", headers=has)
    assert (again.status, nothing, again.headers["ETag"]) == (304, b"", got.headers["ETag"])
    (folders / "dist" / "assets" / "vendor.js").write_bytes(SCRIPT + b"//")
    changed, body = await site.ask("/assets/vendor.js", headers=has)
    assert (changed.status, body) == (200, SCRIPT + b"//")


async def test_only_what_has_its_content_in_its_name_is_kept_without_asking(site: Site) -> None:
    told = [(await site.ask(f"/{name}"))[0].headers["Cache-Control"] for name in ("", "assets/vendor.js")]
    assert told == ["no-cache", "no-cache"]
    hashed, _ = await site.ask("/assets/index-Bx3_-9aQ.js")
    assert "immutable" in hashed.headers["Cache-Control"]


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "X"])
async def test_other_methods_are_refused_with_those_that_there_are(site: Site, method: str) -> None:
    got, body = await site.ask("/", method)
    assert (got.status, got.headers["Allow"]) == (405, "GET, HEAD")
    assert method.encode() in body


@pytest.mark.parametrize(
    "path",
    [
        "/nothing",
        "/assets",
        "/assets/",
        "//",
        "/../secret.js",
        "/%2e%2e/secret.js",
        "/..%2fsecret.js",
        "/assets/../../secret.js",
        "/assets/out.js",
        "/assets//vendor.js",
        "/./index.html",
        "//127.0.0.1/secret.js",
        "/%00",
        "/%ff",
        "//x/index.html",
        "http://127.0.0.1/index.html",
        "index.html",
        f"/{'a' * 5000}",
        "/robot",
        "/robot/",
        "/robot/description.txt",
        f"/robot/{PACKAGE}",
        f"/robot/{PACKAGE}/../../secret.stl",
        f"/robot/{PACKAGE}/%2e%2e/secret.stl",
        f"/robot/{PACKAGE}/..%2fsecret.stl",
        f"/robot/{PACKAGE}//etc/hosts",
        f"/robot/{PACKAGE}/%2fetc/hosts",
        f"/robot/{PACKAGE}/assets/out.stl",
        "/robot/other/assets/base.stl",
    ],
)
async def test_nothing_else_is_there(site: Site, path: str) -> None:
    got, body = await site.ask(path)
    assert (got.status, got.headers["Content-Type"]) == (404, "text/plain; charset=utf-8")
    assert body.endswith(b"\n")
    assert b"key" not in body


async def test_a_robot_s_files_may_be_read_by_pages_of_other_origins_and_the_page_may_not(site: Site) -> None:
    for path in ("/robot/description.urdf", f"/robot/{PACKAGE}/assets/base.stl", "/robot/nothing"):
        assert (await site.ask(path))[0].headers["Access-Control-Allow-Origin"] == "*"
    assert (await site.ask("/"))[0].headers["Access-Control-Allow-Origin"] is None


async def test_compas_fab_finds_the_meshes_that_the_description_names(site: Site) -> None:
    # What compas_fab 2's HttpFileServerLoader does with `http_file_server_base_url`.
    base_url = f"http://127.0.0.1:{site.port}/robot".rstrip("/") + "/"
    _, description = await site.ask("/robot/description.urdf")
    url = f"package://{PACKAGE}/assets/base.stl"
    assert url.encode() in description

    def load() -> bytes:
        with urlopen(urljoin(base_url, url[len("package://") :]), timeout=10) as response:
            content: bytes = response.read()
        return content

    assert await asyncio.to_thread(load) == MESH


async def test_a_file_that_is_too_large_is_told_once_with_the_limit(
    site: Site, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(robot_files, "MAX_FILE_BYTES", 4)
    for _ in range(2):
        got, body = await site.ask(f"/robot/{PACKAGE}/assets/base.stl")
        assert got.status == 413
        assert body.startswith(f"'package://{PACKAGE}/assets/base.stl' has {len(MESH)} bytes, the limit is 4".encode())
    assert caplog.text.count("the limit is 4") == 1


async def test_the_log_is_told_of_no_more_files_than_one_reads(caplog: pytest.LogCaptureFixture) -> None:
    made = HttpGate()
    for number in range(2 * gate.MAX_TOLD):
        made._tell_once(f"file {number}")
    assert len(caplog.records) == gate.MAX_TOLD


async def test_a_file_that_cannot_be_read_is_an_error_of_the_server(
    site: Site, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(self: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", broken)
    got, _ = await site.ask("/assets/vendor.js")
    assert got.status == 500
    assert "'assets/vendor.js' cannot be read: Permission denied" in caplog.text


async def test_without_a_page_it_says_how_to_get_it_and_finds_it_once_it_is_there(site: Site, folders: Path) -> None:
    (folders / "dist").rename(folders / "elsewhere")
    got, body = await site.ask("/")
    assert (got.status, got.headers["Content-Type"]) == (404, "text/html; charset=utf-8")
    assert page.HOW_TO_GET_IT.encode() in body
    (folders / "elsewhere").rename(folders / "dist")
    assert (await site.ask("/"))[0].status == 200


async def test_a_robot_without_files_has_its_description_and_no_robot_nothing() -> None:
    answer = await HttpGate(model.builtin())._robot_file("description.urdf", gzipped=False)
    assert answer.body == model.builtin().urdf.encode()
    with pytest.raises(ServiceError, match="no robot"):
        await HttpGate()._robot_file("description.urdf", gzipped=False)


@pytest.mark.parametrize("path", ["/", "/robot/description.urdf", "/nothing", "/?ros=1"])
async def test_a_websocket_is_one_whatever_its_path(site: Site, path: str) -> None:
    async with connect(f"ws://127.0.0.1:{site.port}{path}") as websocket:
        await websocket.send('{"op": "call_service", "service": "/none", "id": "a"}')
        assert "/none" in str(await asyncio.wait_for(websocket.recv(), 5.0))


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


async def test_clients_that_do_not_read_take_a_bounded_part_of_memory(
    site: Site, folders: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    async with asyncio.timeout(30.0):
        while (await site.ask(path))[0].status != 200:
            await asyncio.sleep(0.01)


def test_the_largest_mesh_has_the_time_it_needs_over_a_poor_wireless_link() -> None:
    poor_link_bytes_s = 200_000
    assert robot_files.MAX_FILE_BYTES / poor_link_bytes_s < OPEN_TIMEOUT_S
