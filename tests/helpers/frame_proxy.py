"""A proxy between a client and the server, which runs a function before each operation of the client goes on."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any
from urllib.request import urlopen

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.sync.server import ServerConnection, serve

from harness.server import free_port
from harness.waiting import TIMEOUT_S

Operation = dict[str, Any]


@contextmanager
def frame_proxy(port: int, before: Callable[[Operation], None]) -> Iterator[int]:
    """Serve a port of this machine, whose connections go on to another; yield its number."""

    def fetched(_client: ServerConnection, request: Request) -> Response | None:
        if "Upgrade" in request.headers:
            return None
        with urlopen(f"http://127.0.0.1:{port}{request.path}", timeout=TIMEOUT_S) as answer:
            body = answer.read()
        return Response(200, "OK", Headers({"Content-Length": str(len(body))}), body)

    def relay(source: Connection, sink: Connection, seen: Callable[[Operation], None]) -> None:
        with suppress(ConnectionClosed):
            for frame in source:
                if isinstance(frame, str):
                    seen(json.loads(frame))
                sink.send(frame)
        sink.close()

    def relay_both(client: ServerConnection) -> None:
        with connect(f"ws://127.0.0.1:{port}{client.request.path}", max_size=None) as server:
            answers = threading.Thread(target=relay, args=(server, client, lambda _answer: None))
            answers.start()
            relay(client, server, before)
            answers.join(TIMEOUT_S)

    with serve(relay_both, "127.0.0.1", free_port(), process_request=fetched, max_size=None) as proxy:
        serving = threading.Thread(target=proxy.serve_forever)
        serving.start()
        yield proxy.socket.getsockname()[1]
        proxy.shutdown()
        serving.join(TIMEOUT_S)
