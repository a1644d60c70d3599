"""What the container's engine asks about its health."""

import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from docker import health
from harness.waiting import join
from tests.helpers.resources import make_pair


class Answers(BaseHTTPRequestHandler):
    """It lives, and is not ready."""

    def do_GET(self) -> None:
        self.send_response(200 if self.path == "/livez" else 503)
        self.end_headers()
        self.wfile.write(f"asked for {self.path}".encode())

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def running(monkeypatch: pytest.MonkeyPatch, context: ssl.SSLContext | None = None) -> Iterator[None]:
    with HTTPServer(("127.0.0.1", 0), Answers) as server:
        if context is not None:
            server.socket = context.wrap_socket(server.socket, server_side=True)
        monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", str(server.server_port))
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield
        server.shutdown()
        join(thread)


def test_a_server_that_lives_is_healthy_and_one_that_is_not_ready_says_why(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(monkeypatch):
        assert health.main([]) == 0
        assert health.main(["readyz"]) == 1
    assert capsys.readouterr().out == "asked for /livezasked for /readyz"


def test_a_server_with_a_certificate_of_its_own_is_asked_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*make_pair(tmp_path))
    with running(monkeypatch, context):
        assert health.main([]) == 0


def test_nobody_there_is_not_healthy(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "1")
    assert health.main([]) == 1
    assert "no answer at 127.0.0.1:1/livez" in capsys.readouterr().out
