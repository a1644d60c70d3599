"""Rosbridge client of a command: it calls services of a running server, and keeps the newest messages of topics."""

import itertools
import json
import time
from collections.abc import Mapping
from typing import Any

from websockets.sync.client import ClientConnection

from robot.errors import RobotError

# A server on the same network answers within milliseconds, a busy one within seconds.
ANSWER_TIMEOUT_S = 10.0


class ServerLost(RobotError):  # noqa: N818 - named by the fact
    """The server cannot be reached, refuses, or has left."""


class CallingClient:
    """Client on a connection; ``messages`` has the newest message of each topic."""

    def __init__(self, websocket: ClientConnection) -> None:
        self.messages: dict[str, Any] = {}
        self._websocket = websocket
        self._numbers = itertools.count(1)

    def send(self, **operation: Any) -> None:
        self._websocket.send(json.dumps(operation))

    def subscribe(self, topic: str, type_name: str) -> None:
        self.send(op="subscribe", topic=topic, type=type_name)

    def call(self, service: str, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the response of a service; raises ServerLost where there is none."""
        number = str(next(self._numbers))
        self.send(op="call_service", service=service, id=number, args=request)
        until_s = time.monotonic() + ANSWER_TIMEOUT_S
        while (left_s := until_s - time.monotonic()) > 0.0:
            reply = self.receive(left_s)
            if reply.get("op") == "service_response" and reply.get("id") == number:
                if not reply["result"]:
                    raise ServerLost(str(reply["values"]))
                values: dict[str, Any] = reply["values"]
                return values
        raise ServerLost(f"the server did not answer {service} within {ANSWER_TIMEOUT_S:g} s")

    def receive(self, timeout_s: float) -> dict[str, Any]:
        """Return the next operation, which is empty when none comes in time [s]."""
        try:
            operation: dict[str, Any] = json.loads(self._websocket.recv(timeout_s))
        except TimeoutError:
            return {}
        if operation.get("op") == "publish":
            self.messages[operation["topic"]] = operation["msg"]
        return operation
