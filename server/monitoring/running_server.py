"""The server of this machine as a report asks it: health, metrics, diagnostics and the last lines of its log."""

from __future__ import annotations

import contextlib
import json
import ssl
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from server.config import Settings
from server.monitoring.log_ring import SERVICE as LOG
from server.monitoring.report import Report
from server.monitoring.ros_topics import JOINT_PREFIX
from server.monitoring.servo_history import SERVICE as HISTORY

TIMEOUT_S = 3.0

# /diagnostics comes once a second, of a slow simulated arm more rarely.
DIAGNOSTICS_TIMEOUT_S = 6.0

MAX_ANSWER_BYTES = 5_000_000

# Member and type of each topic.
_TOPICS = {
    "/arm/state": ("arm_state", "diagnostic_msgs/DiagnosticStatus"),
    "/diagnostics": ("diagnostics", "diagnostic_msgs/DiagnosticArray"),
}


class RunningServer:
    """The server that the settings describe, if it runs on this machine."""

    def __init__(self, settings: Settings, token: str | None) -> None:
        server = settings.server
        # An address of all interfaces is none to connect to.
        host = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}.get(server.host, server.host)  # noqa: S104
        self.address = f"[{host}]:{server.port}" if ":" in host else f"{host}:{server.port}"
        self._context: ssl.SSLContext | None = None
        if server.tls_certificate is not None:
            # Its certificate may have another name than the address; it is the one in the server's own settings.
            self._context = ssl.create_default_context(cafile=str(server.tls_certificate))
            self._context.check_hostname = False
        self._headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        self.health = self._health()
        self.runs = self.health is not None

    def add_to(self, report: Report) -> set[Path]:
        """Add the server's answers; return the directory of its files about faults, if it names one."""
        report.add_json("server/health.json", self.health)
        with report.part("server/metrics.txt"):
            report.add("server/metrics.txt", self._get("metrics", self._headers))
        heard: dict[str, Any] = {}
        with report.part("server/diagnostics.json"), self._connected() as client:
            heard = self._ask(client, report)
            report.add_json("server/servo_history.json", _histories(client, heard.get("diagnostics", {})))
        for name, message in heard.items():
            report.add_json(f"server/{name}.json", message)
        values = [each for status in heard.get("diagnostics", {}).get("status", ()) for each in status["values"]]
        return {Path(each["value"]).parent for each in values if each["key"] == "fault_file"}

    def _health(self) -> Any:
        """Return the answer at /healthz; None when nobody answers, or somebody else."""
        with contextlib.suppress(OSError, ValueError):
            health = json.loads(self._get("healthz", {}))
            return health if isinstance(health, dict) and "live" in health else None
        return None

    def _get(self, path: str, headers: dict[str, str]) -> str:
        scheme = "http" if self._context is None else "https"
        request = urllib.request.Request(f"{scheme}://{self.address}/{path}", headers=headers)  # noqa: S310
        handler = urllib.request.HTTPSHandler(context=self._context)
        # No proxy is asked for a server on this machine; an answer of 503 is one as well.
        opener = urllib.request.OpenerDirector()
        for each in (urllib.request.HTTPHandler(), handler):
            opener.add_handler(each)
        with opener.open(request, timeout=TIMEOUT_S) as answer:
            return str(answer.read(MAX_ANSWER_BYTES).decode(errors="replace"))

    def _connected(self) -> ClientConnection:
        scheme = "ws" if self._context is None else "wss"
        return connect(
            f"{scheme}://{self.address}/",
            ssl=self._context,
            additional_headers=self._headers,
            open_timeout=TIMEOUT_S,
            close_timeout=TIMEOUT_S,
            proxy=None,
            max_size=MAX_ANSWER_BYTES,
        )

    def _ask(self, client: ClientConnection, report: Report) -> dict[str, Any]:
        for topic, (_, type_name) in _TOPICS.items():
            client.send(json.dumps({"op": "subscribe", "topic": topic, "type": type_name}))
        client.send(json.dumps({"op": "call_service", "service": LOG, "id": "log"}))
        heard: dict[str, Any] = {}
        answered = False
        for operation in _operations(client):
            if operation["op"] == "publish":
                heard[_TOPICS[operation["topic"]][0]] = operation["msg"]
            elif operation["op"] == "service_response":
                answered = True
                self._add_log(report, operation)
            if answered and len(heard) == len(_TOPICS):
                return heard
        report.note(f"server: {', '.join(_TOPICS)} and its log were not all heard in {DIAGNOSTICS_TIMEOUT_S:g} s")
        return heard

    def _add_log(self, report: Report, answer: dict[str, Any]) -> None:
        if answer["result"]:
            report.add("server/log.txt", answer["values"]["message"] + "\n")
        else:
            report.note(f"server: its log is not returned: {answer['values']}")


def _histories(client: ClientConnection, diagnostics: dict[str, Any]) -> dict[str, Any]:
    """Ask for the history of every servo on ``/diagnostics``, by joint; those that are not answered are missing."""
    histories: dict[str, Any] = {}
    joints = [each["name"].removeprefix(JOINT_PREFIX) for each in diagnostics.get("status", ())[1:]]
    for joint in joints:
        client.send(json.dumps({"op": "call_service", "service": HISTORY, "id": joint, "args": {"joint": joint}}))
    for operation in _operations(client) if joints else ():
        if operation["op"] == "service_response":
            histories[operation["id"]] = operation["values"]
        if len(histories) == len(joints):
            break
    return histories


def _operations(client: ClientConnection) -> Iterator[dict[str, Any]]:
    until_s = time.monotonic() + DIAGNOSTICS_TIMEOUT_S
    with contextlib.suppress(TimeoutError):
        while (left_s := until_s - time.monotonic()) > 0.0:
            yield json.loads(client.recv(timeout=left_s))
