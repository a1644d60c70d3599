"""A proxy between a client and the server, which runs a function before each operation of the client goes on."""

import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from harness.server import free_port
from harness.waiting import TIMEOUT_S

Operation = dict[str, Any]


class _Pipe:
    """One direction of a connection."""

    def __init__(self, source: socket.socket, sink: socket.socket) -> None:
        self._source, self._sink, self._held = source, sink, b""

    def relay(self) -> None:
        with suppress(OSError):
            while data := self._source.recv(65536):
                self._sink.sendall(data)
        with suppress(OSError):
            self._sink.shutdown(socket.SHUT_WR)

    def relay_frames(self, before: Callable[[Operation], None]) -> None:
        """Relay a request of HTTP and, behind it, masked WebSocket frames (RFC 6455, 5.2)."""
        with suppress(OSError, EOFError):
            head = self._until(b"\r\n\r\n")
            self._sink.sendall(head)
            while b"Upgrade: websocket" in head:
                start = self._take(2)
                size = start[1] & 0x7F
                extended = self._take({126: 2, 127: 8}.get(size, 0))
                mask, masked = self._take(4), self._take(int.from_bytes(extended, "big") or size)
                if start[0] & 0x0F == 1:
                    text = bytes(octet ^ mask[place % 4] for place, octet in enumerate(masked))
                    before(json.loads(text))
                self._sink.sendall(start + extended + mask + masked)
        self.relay()

    def _until(self, end: bytes) -> bytes:
        while end not in self._held:
            self._receive()
        return self._take(self._held.index(end) + len(end))

    def _take(self, size: int) -> bytes:
        while len(self._held) < size:
            self._receive()
        taken, self._held = self._held[:size], self._held[size:]
        return taken

    def _receive(self) -> None:
        if not (data := self._source.recv(65536)):
            raise EOFError
        self._held += data


@contextmanager
def frame_proxy(port: int, before: Callable[[Operation], None]) -> Iterator[int]:
    """Serve a port of this machine, whose connections go on to another; yield its number."""
    with socket.create_server(("127.0.0.1", free_port())) as listener:
        connections: list[threading.Thread] = []

        def connect(client: socket.socket) -> None:
            with client, socket.create_connection(("127.0.0.1", port)) as server:
                answers = threading.Thread(target=_Pipe(server, client).relay)
                answers.start()
                _Pipe(client, server).relay_frames(before)
                answers.join()

        def serve() -> None:
            with suppress(OSError):
                while True:
                    connections.append(threading.Thread(target=connect, args=listener.accept()[:1]))
                    connections[-1].start()

        accepting = threading.Thread(target=serve)
        accepting.start()
        yield listener.getsockname()[1]
        listener.shutdown(socket.SHUT_RDWR)
        for thread in (accepting, *connections):
            thread.join(TIMEOUT_S)
