"""Rosbridge client of a running server's verification, at a terminal."""

import math
from collections.abc import Mapping
from contextlib import closing
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from robot.errors import RobotError
from server.arm.commissioning import ANSWER, BEGIN, CANCEL, STATE_TOPIC
from server.commands.terminal import ExitCode, Terminal, chosen, prompt, table
from server.rosbridge_clients import ANSWER_TIMEOUT_S, CallingClient, ServerLost

# Between looks at the keyboard.
POLL_S = 0.05


def verify(url: str, token: str | None, terminal: Terminal, arm: str) -> ExitCode:
    """Have a server verify its arm, by name of one of several; raises ServerLost."""
    try:
        # Where Ctrl-C ends it, the connection alone would close with 1011, an internal error.
        with connect(url, open_timeout=ANSWER_TIMEOUT_S, max_size=None) as websocket, closing(websocket):
            return VerificationClient(websocket, terminal, arm).run(token)
    except (OSError, ValueError, WebSocketException) as error:
        raise ServerLost(f"{url}: {str(error) or type(error).__name__}; is armbridge serve running there?") from error


class VerificationClient:
    """Client of the server's procedure."""

    def __init__(self, websocket: ClientConnection, terminal: Terminal, arm: str) -> None:
        self._client = CallingClient(websocket)
        self._terminal = terminal
        self._prefix = arm and f"/{arm}"

    @property
    def _state(self) -> Mapping[str, Any]:
        state: Mapping[str, Any] = self._client.messages.get(f"{self._prefix}{STATE_TOPIC}", {})
        return state

    def run(self, token: str | None) -> ExitCode:
        if token is not None:
            self._client.send(op="auth", token=token)
        self._call(BEGIN, {"procedure": "verify", "name": ""})
        self._client.subscribe(f"{self._prefix}{STATE_TOPIC}", "armbridge_msgs/CommissioningState")
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
                self._client.receive(POLL_S)
                continue
            answer = chosen(line, self._state["answers"])
            try:
                self._call(ANSWER, {"step": step, "answer": answer})
            except ServerLost as refusal:
                self._terminal.err(str(refusal))
                self._show()
            else:
                self._client.receive(ANSWER_TIMEOUT_S)
        findings = self._state["findings"]
        for finding in findings:
            self._terminal.out(f"* {finding}")
        self._terminal.out(self._state["result"])
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
            self._terminal.err(table(("joint", "deg from its goal"), measured))
        if instruction := self._state.get("instruction", ""):
            self._terminal.ask(f"{instruction}{prompt(answers)}")

    def _call(self, service: str, request: Mapping[str, Any]) -> None:
        response = self._client.call(f"{self._prefix}{service}", request)
        if not response["success"]:
            raise ServerLost(response["message"])
