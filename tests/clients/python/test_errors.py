"""Each way in which a connection fails has an exception of its own, whose text says what to do."""

import asyncio
import http.server
import json
import socket
import ssl
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response

from armbridge_client import (
    ConnectError,
    ConnectionLost,
    DeadlineExceeded,
    NotArmbridge,
    NotAuthenticated,
    NotPermitted,
    ServerUnreachable,
    WrongVersion,
    connect,
    connect_async,
    connection,
)
from armbridge_client.connection import Address, Connection
from armbridge_client.messages import TYPES, String, TriggerRequest
from harness.server import FAST, RunningServer, free_port
from harness.waiting import until
from server.access.certificates import CertificateFiles, issue_certificate


class ScriptedServer:
    """A rosbridge server on this loop whose answers are a function of the operation; drops clients on demand."""

    def __init__(self, answer: Callable[[dict[str, Any]], dict[str, Any] | None]) -> None:
        self._answer = answer
        self.url = ""
        self.operations: list[dict[str, Any]] = []
        self.clients: list[ServerConnection] = []

    async def handle(self, client: ServerConnection) -> None:
        self.clients.append(client)
        async for text in client:
            operation = json.loads(text)
            self.operations.append(operation)
            answer = self._answer(operation)
            if answer is not None:
                await client.send(json.dumps({"op": "service_response", "id": operation.get("id"), **answer}))


@asynccontextmanager
async def scripted(
    answer: Callable[[dict[str, Any]], dict[str, Any] | None], context: ssl.SSLContext | None = None
) -> AsyncIterator[ScriptedServer]:
    made = ScriptedServer(answer)
    async with serve(made.handle, "127.0.0.1", 0, process_request=document, ssl=context) as server:
        made.url = f"{'wss' if context else 'ws'}://127.0.0.1:{next(iter(server.sockets)).getsockname()[1]}"
        yield made


@asynccontextmanager
async def connected(answer: Callable[..., dict[str, Any] | None]) -> AsyncIterator[tuple[ScriptedServer, Connection]]:
    """A connection to a scripted server."""
    async with scripted(answer) as server:
        connection = Connection(Address(server.url))
        await connection.open()
        yield server, connection
        await connection.close()


def document(connection: ServerConnection, request: Request) -> Response | None:
    """Answer the request for the server's description; other requests are WebSockets."""
    arm = {"name": "", "robot": "r", "group": "g", "groups": {}, "gripper": [], "frame": "base", "tip": "tip"}
    answer = connection.respond(HTTPStatus.OK, json.dumps({"types": TYPES, "arms": [arm]}))
    return answer if request.path.endswith("/armbridge/interface.json") else None


def identity(version: str) -> dict[str, Any]:
    names = json.dumps({"name": "me", "role": "admin", "version": version})
    return {"service": "/arm/who_am_i", "result": True, "values": {"success": True, "message": names}}


async def refused(answer: dict[str, Any]) -> ConnectError:
    """The error of a connection to a server that answers the first call so."""
    async with scripted(lambda _: answer) as server:
        with pytest.raises(ConnectError) as caught:
            await connect_async(server.url)
    return caught.value


def test_nothing_listens() -> None:
    port = free_port()
    with pytest.raises(ServerUnreachable, match=f"no server answers at ws://127.0.0.1:{port}: start one"):
        connect(f"ws://127.0.0.1:{port}")


@pytest.mark.parametrize("url", ["", "127.0.0.1:9090", "http://127.0.0.1:9090", "ws://", "ws://127.0.0.1:port"])
def test_an_address_that_is_none(url: str) -> None:
    with pytest.raises(ConnectError, match="must be ws://HOST:PORT or wss://HOST:PORT"):
        connect(url)


def test_a_server_that_never_answers_is_given_up_after_the_deadline() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent, pytest.raises(DeadlineExceeded, match="no answer"):
        connect(f"ws://127.0.0.1:{silent.getsockname()[1]}", timeout_s=0.2)


def test_a_wait_for_the_server_is_logged(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(connection, "QUIET_S", 0.0)
    with socket.create_server(("127.0.0.1", 0)) as silent, pytest.raises(DeadlineExceeded):
        connect(url := f"ws://127.0.0.1:{silent.getsockname()[1]}", timeout_s=0.2)
    assert caplog.messages == [f"{url}: no answer yet; waiting up to 0.2 s"]


def test_a_web_server_is_not_armbridge() -> None:
    with http.server.HTTPServer(("127.0.0.1", 0), http.server.BaseHTTPRequestHandler) as web:
        threading.Thread(target=web.handle_request, daemon=True).start()
        with pytest.raises(NotArmbridge):
            connect(f"ws://127.0.0.1:{web.server_port}")


@pytest.mark.parametrize(
    "values",
    ["Service /arm/who_am_i does not exist", {"success": True, "message": "alice"}, {"success": True}, None, 3],
)
async def test_another_rosbridge_server_is_not_armbridge(values: object) -> None:
    error = await refused({"service": "/arm/who_am_i", "result": False, "values": values})
    assert isinstance(error, NotArmbridge)


async def test_another_version_or_description_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    error = await refused(identity("9.7.1"))
    assert isinstance(error, WrongVersion)
    assert "install armbridge-client 9.7" in str(error)
    monkeypatch.setattr("armbridge_client.interface.TYPES", {**TYPES, "std_msgs/msg/String": "RIHS01_0"})
    error = await refused(identity("0.2.0"))
    assert isinstance(error, WrongVersion)
    assert "std_msgs/msg/String" in str(error)
    monkeypatch.setattr("armbridge_client.interface.PATH", "nothing.json")
    assert "nothing.json" in str(await refused(identity("0.2.0")))


@pytest.mark.parametrize("token", [None, "wrong" * 5])
def test_a_token_that_is_missing_or_wrong(guarded: RunningServer, token: str | None) -> None:
    with pytest.raises(NotAuthenticated, match="token"):
        connect(guarded.url, token=token)


def test_the_token_of_the_environment_is_sent_unless_another_is_passed(
    guarded: RunningServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ARMBRIDGE_TOKEN", "v" * 24)
    for token, role in ((None, "view"), ("o" * 24, "operate")):
        with connect(guarded.url, token=token) as arm:
            assert arm.server.role == role
    with pytest.raises(NotAuthenticated):
        connect(guarded.url, token="")


def test_a_viewers_token_shows_and_stops_but_moves_nothing(guarded: RunningServer) -> None:
    with connect(guarded.url, token="v" * 24) as viewer:
        assert viewer.server.role == "view"
        assert viewer.state().mode == "holding"
        assert viewer.plan("home").duration_s >= 0.0
        viewer.stop()
        for refusing in (lambda: viewer.move_named("home"), viewer.enable, viewer.gripper.open):
            with pytest.raises(NotPermitted, match=r"needs the role (propose|operate), this client has view"):
                refusing()
        with pytest.raises(NotPermitted):
            viewer.named_states.save("mine")


def test_an_operators_token_moves_but_saves_nothing(guarded: RunningServer) -> None:
    with connect(guarded.url, token="o" * 24) as operator:
        operator.move_named("ready")
        with pytest.raises(NotPermitted, match="needs the role admin"):
            operator.named_states.save("mine")


async def test_requests_fail_and_streams_go_on_when_the_connection_breaks() -> None:
    def answer(operation: dict[str, Any]) -> dict[str, Any] | None:
        return identity("0.2.0") if operation.get("service") == "/arm/who_am_i" else None

    async with (
        connected(answer) as (server, connection),
        connection.subscribe("/chat", TriggerRequest, timeout_s=20.0) as stream,
    ):
        waiting = asyncio.create_task(connection.call("/slow", TriggerRequest()))
        await until(lambda: any(operation.get("service") == "/slow" for operation in server.operations))
        await server.clients[0].close(1011)
        with pytest.raises(ConnectionLost, match="stops this client's motions"):
            await waiting
        with pytest.raises(ConnectionLost, match="not connected"):
            await connection.call("/slow", TriggerRequest())
        await connection.wait_connected()
        assert [each["topic"] for each in server.operations if each["op"] == "subscribe"] == ["/chat", "/chat"]
        await server.clients[1].send(json.dumps({"op": "publish", "topic": "/chat", "msg": {}}))
        assert await stream.__anext__() == TriggerRequest()


async def test_a_server_that_closes_while_the_client_returns_is_tried_again() -> None:
    clients: list[ServerConnection] = []

    def answer(operation: dict[str, Any]) -> dict[str, Any]:
        # As a server that is shutting down: it takes the second connection, and closes it before it answers.
        if len(clients) == 2:
            clients[1].transport.abort()
        return identity("0.2.0")

    async with connected(answer) as (server, connection):
        clients = server.clients
        await clients[0].close(1001)
        await until(lambda: len(clients) >= 3)
        await connection.wait_connected(20.0)
        assert (await connection.call("/arm/who_am_i", TriggerRequest())).success


async def test_a_slow_reader_of_a_stream_loses_the_oldest_messages() -> None:
    async with (
        connected(lambda _: identity("0.2.0")) as (server, connection),
        connection.subscribe("/chat", String, length=3) as stream,
    ):
        for number in range(1000):
            message = {"op": "publish", "topic": "/chat", "msg": {"data": str(number)}}
            await server.clients[0].send(json.dumps(message))
        # The answer comes behind the messages.
        await connection.call("/arm/who_am_i", TriggerRequest())
        assert [(await stream.__anext__()).data for _ in range(3)] == ["997", "998", "999"]


def test_a_server_that_dies_during_a_motion_is_a_lost_connection() -> None:
    with RunningServer(settings=FAST) as server, connect(server.url) as arm:

        def on_progress(progress: Any) -> None:
            if progress.state == "executing":
                server.process.kill()

        arm.move_named("home")
        with pytest.raises(ConnectionLost, match="connection lost"):
            arm.move("rest", speed=0.05, on_progress=on_progress)
        with pytest.raises(ConnectionLost, match="not connected"):
            arm.stop()
        with pytest.raises(DeadlineExceeded):
            arm.wait_connected(timeout_s=0.1)


async def test_tls_sends_nothing_to_a_server_whose_certificate_is_unknown(tmp_path: Path) -> None:
    files = CertificateFiles(tmp_path)
    issue_certificate(files, ["127.0.0.1"])
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(files.certificate, files.key)
    async with scripted(lambda _: identity("0.2.0"), context) as server:
        with pytest.raises(ConnectError, match=r"TLS: .*pass tls= for a certificate of your own"):
            await connect_async(server.url, token="o" * 24)
        assert server.clients == []
        async with await connect_async(server.url, tls=ssl.create_default_context(cafile=files.authority)) as arm:
            assert arm.server.role == "admin"
