"""Rosbridge client of a running server's verification, at a terminal."""

import itertools
import json
import math
from collections.abc import Mapping
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from robot.errors import RobotError
from server.arm.commissioning import ANSWER, BEGIN, CANCEL, STATE_TOPIC
from server.commands.terminal import ExitCode, Terminal, chosen, prompt, table

# A server on the same network answers within milliseconds, a busy one within seconds.
ANSWER_TIMEOUT_S = 10.0

# Between looks at the keyboard.
POLL_S = 0.05


class ServerLost(RobotError):  # noqa: N818 - named by the fact
    """The server cannot be reached, refuses, or has left."""


def verify(url: str, token: str | None, terminal: Terminal, arm: str = "") -> ExitCode:
    """Have a server verify its arm, by name of one of several; raises ServerLost."""
    try:
        with connect(url, open_timeout=ANSWER_TIMEOUT_S, max_size=None) as websocket:
            return VerificationClient(websocket, terminal, arm).run(token)
    except (OSError, ValueError, WebSocketException) as error:
        raise ServerLost(f"{url}: {str(error) or type(error).__name__}; is armbridge serve running there?") from error


class VerificationClient:
    """Client of the server's procedure."""

    def __init__(self, websocket: ClientConnection, terminal: Terminal, arm: str = "") -> None:
        self._websocket = websocket
        self._terminal = terminal
        self._prefix = arm and f"/{arm}"
        self._numbers = itertools.count(1)
        self._state: Mapping[str, Any] = {}
        self._told: set[str] = set()

    def run(self, token: str | None) -> ExitCode:
        if token is not None:
            self._send({"op": "auth", "token": token})
        self._call(BEGIN, {"procedure": "verify", "name": ""})
        self._send(
            {"op": "subscribe", "topic": f"{self._prefix}{STATE_TOPIC}", "type": "armbridge_msgs/CommissioningState"}
        )
        try:
            return self._converse()
        except (KeyboardInterrupt, RobotError):
            self._call(CANCEL, {})
            raise

    def _converse(self) -> ExitCode:
        shown = ""
        while not self._state.get("result"):
            step = self._state.get("step", "")
            if step != shown:
                shown = step
                self._show()
            line = self._terminal.line_typed() if self._state.get("answers") else None
            if line is None:
                self._receive(POLL_S)
                continue
            answer = chosen(line, self._state["answers"])
            try:
                self._call(ANSWER, {"step": step, "answer": answer})
            except ServerLost as refusal:
                self._terminal.say(str(refusal))
                self._show()
            else:
                self._receive(ANSWER_TIMEOUT_S)
        findings = self._state["findings"]
        for finding in findings:
            self._terminal.tell(f"* {finding}")
        self._terminal.tell(self._state["result"])
        if "ended early" in self._state["result"]:
            return ExitCode.FAILED
        return ExitCode.PROBLEMS if findings else ExitCode.DONE

    def _show(self) -> None:
        answers = self._state.get("answers", [])
        measured = [
            (each["joint"], f"{math.degrees(abs(each['droop_rad'])):.1f}")
            for each in self._state.get("joints", [])
            if each["droop_rad"] is not None
        ]
        if measured and answers:
            self._terminal.say(table(("joint", "deg from its goal"), measured))
        if instruction := self._state.get("instruction", ""):
            self._terminal.ask(f"{instruction}{prompt(answers)}")

    def _send(self, operation: Mapping[str, Any]) -> None:
        self._websocket.send(json.dumps(operation))

    def _call(self, name: str, request: Mapping[str, Any]) -> None:
        service, number = f"{self._prefix}{name}", str(next(self._numbers))
        self._send({"op": "call_service", "service": service, "id": number, "args": request})
        while (reply := self._receive(ANSWER_TIMEOUT_S)) is not None:
            if reply.get("op") == "service_response" and reply.get("id") == number:
                values = reply["values"]
                if reply["result"] and values["success"]:
                    return
                raise ServerLost(str(values["message"] if reply["result"] else values))
        raise ServerLost(f"the server did not answer {service} within {ANSWER_TIMEOUT_S:g} s")

    def _receive(self, timeout_s: float) -> dict[str, Any] | None:
        """Take the next message, None when none comes in time; a state is kept."""
        try:
            message: dict[str, Any] = json.loads(self._websocket.recv(timeout_s))
        except TimeoutError:
            return None
        if message.get("topic") == f"{self._prefix}{STATE_TOPIC}":
            self._state = message["msg"]
        return message
