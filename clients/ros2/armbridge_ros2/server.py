"""A connection to an armbridge server: threads of its own, made again when it is lost."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any

import cbor2
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from armbridge_ros2.interfaces import Joined

FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 10.0
MAX_FRAME_BYTES = 64 * 1024 * 1024
# Topic and services that stop the arm.
STOPS = frozenset({"/stop", "/arm/stop", "/arm/emergency_stop"})
# MoveIt's topic that stops the arm by one word, and the message.
STOP_EVENT = ("/trajectory_execution_event", {"data": "stop"})


class Server:
    """Speaks rosbridge. Subscriptions and advertisements are sent again on each connection.

    Args:
        url: ``ws://HOST:PORT``.
        token: authentication token, or empty.
        on_message: called with a topic and a message's serialized bytes, on the connection's thread.
        report: called with a sentence about the connection, or about what the server refuses.
    """

    def __init__(
        self, url: str, token: str, on_message: Callable[[str, bytes], None], report: Callable[[str], None]
    ) -> None:
        self._url = url
        self._headers = {"Authorization": f"Bearer {token}"} if token else None
        self._on_message = on_message
        self._report = report
        self._registrations: list[dict[str, Any]] = [{"op": "set_level", "level": "error"}]
        self._calls: dict[str, Future[dict[str, Any]]] = {}
        self._on_feedback: dict[str, Callable[[dict[str, Any]], None]] = {}
        self._number = 0
        self._lock = threading.Lock()
        # Goals are sent from threads of their own: none goes out behind a stop that came after it.
        self._stops = 0
        self._in_order = threading.Lock()
        self._socket: ClientConnection | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="armbridge", daemon=True)

    def start(self) -> None:
        """Connect; later registrations are sent at once."""
        self._thread.start()

    def close(self) -> None:
        """Disconnect."""
        self._ended.set()
        if (socket := self._socket) is not None:
            socket.close()
        self._thread.join(timeout=2.0 * LONGEST_PAUSE_S)

    def subscribe(self, topic: str, type_name: str) -> None:
        """Ask for a topic's messages as they are serialized by ROS 2 (CDR)."""
        operation = {
            "op": "subscribe",
            "topic": topic,
            "type": type_name,
            "compression": "cbor-raw",
            "queue_length": 10,
        }
        self._register(operation)

    def advertise(self, topic: str, type_name: str) -> None:
        """Announce messages of a topic."""
        self._register({"op": "advertise", "topic": topic, "type": type_name})

    def publish(self, topic: str, message: Any) -> bool:
        """Publish a message; return False if there is no connection."""
        return self._send_in_order(topic, {"op": "publish", "topic": topic, "msg": message})

    def call(self, service: str, request: Any) -> Future[dict[str, Any]]:
        """Call a service; the future has the values of the response, or a ConnectionError or RuntimeError."""
        return self._ask(service, {"op": "call_service", "service": service, "args": request})[1]

    @property
    def stops(self) -> int:
        """Number of stops that were passed on."""
        return self._stops

    def send_goal(
        self, action: Joined, goal: Any, stops: int, on_feedback: Callable[[dict[str, Any]], None]
    ) -> tuple[str, Future[dict[str, Any]]]:
        """Send a goal; the future has its operation ``action_result``, or what :meth:`call` fails with.

        Args:
            action: the action.
            goal: its fields as JSON.
            stops: :attr:`stops` when the goal came; a stop since then refuses the goal.
            on_feedback: called with the values of each feedback, on the connection's thread.

        Returns:
            The goal's number, for :meth:`cancel_goal`, and the future.
        """
        operation = {
            "op": "send_action_goal",
            "action": action.name,
            "action_type": action.type,
            "args": goal,
            "feedback": True,
        }
        return self._ask(action.name, operation, on_feedback, stops)

    def cancel_goal(self, action: str, number: str) -> None:
        """Ask for the end of a goal; its result comes as ever."""
        self._send({"op": "cancel_action_goal", "action": action, "id": number})

    def _ask(
        self,
        name: str,
        operation: dict[str, Any],
        on_feedback: Callable[[dict[str, Any]], None] | None = None,
        stops: int | None = None,
    ) -> tuple[str, Future[dict[str, Any]]]:
        answer: Future[dict[str, Any]] = Future()
        with self._lock:
            self._number += 1
            number = str(self._number)
            self._calls[number] = answer
            if on_feedback is not None:
                self._on_feedback[number] = on_feedback
        answer.add_done_callback(lambda _: self._on_feedback.pop(number, None))
        failure: Exception | None = None
        try:
            if not self._send_in_order(name, {**operation, "id": number}, stops):
                failure = ConnectionError(f"{name}: there is no connection to {self._url}")
        except RuntimeError as error:
            failure = error
        # The connection's thread may have given the call up already.
        if failure is not None and self._calls.pop(number, None) is not None:
            answer.set_exception(failure)
        return number, answer

    def _send_in_order(self, name: str, operation: dict[str, Any], stops: int | None = None) -> bool:
        with self._in_order:
            if name in STOPS or (name, operation.get("msg")) == STOP_EVENT:
                self._stops += 1
            elif stops is not None and stops != self._stops:
                raise RuntimeError(f"{name}: the goal was not sent: a stop came after it")
            return self._send(operation)

    def _register(self, operation: dict[str, Any]) -> None:
        with self._lock:
            self._registrations.append(operation)
        self._send(operation)

    def _send(self, operation: Mapping[str, Any]) -> bool:
        socket = self._socket
        if socket is None:
            return False
        try:
            socket.send(json.dumps(operation))
        except (WebSocketException, OSError):
            return False
        return True

    def _run(self) -> None:
        pause_s = FIRST_PAUSE_S
        while not self._ended.is_set():
            try:
                with connect(
                    self._url, additional_headers=self._headers, max_size=MAX_FRAME_BYTES, compression=None
                ) as socket:
                    with self._lock:
                        for operation in self._registrations:
                            socket.send(json.dumps(operation))
                        self._socket = socket
                    self._report(f"connected to {self._url}")
                    pause_s = FIRST_PAUSE_S
                    for frame in socket:
                        self._take(frame)
                self._lose("the server closed the connection")
            except (WebSocketException, OSError, TimeoutError) as error:
                self._lose(str(error))
            if not self._ended.wait(pause_s):
                pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    def _lose(self, reason: str) -> None:
        with self._lock:
            self._socket = None
            lost, self._calls = self._calls, {}
        for answer in lost.values():
            answer.set_exception(ConnectionError(f"{self._url}: {reason}"))
        if not self._ended.is_set():
            self._report(f"no connection to {self._url}: {reason}")

    def _take(self, frame: str | bytes) -> None:
        operation = json.loads(frame) if isinstance(frame, str) else cbor2.loads(frame)
        match operation["op"]:
            case "publish":
                self._on_message(operation["topic"], operation["msg"]["bytes"])
            case "action_feedback":
                if (on_feedback := self._on_feedback.get(operation["id"])) is not None:
                    on_feedback(operation["values"])
            case "service_response" | "action_result":
                answer = self._calls.pop(operation.get("id", ""), None)
                if answer is not None and operation["result"]:
                    answer.set_result(operation if operation["op"] == "action_result" else operation["values"])
                elif answer is not None:
                    answer.set_exception(RuntimeError(str(operation["values"])))
            # The answer of a call or goal says the same.
            case "status" if operation.get("id") not in self._calls:
                self._report(f"refused: {operation['msg']}")
            case _:
                pass
