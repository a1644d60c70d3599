"""Report of an installation, its arm and its running server: one archive, without secrets."""

import contextlib
import io
import json
import os
import platform
import re
import ssl
import sys
import time
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from serial.tools import list_ports
from websockets.sync.client import connect

from robot.logs import without_secrets
from server.config import Settings
from server.monitoring.fault_files import PREFIX
from server.monitoring.log_ring import SERVICE as LOG
from server.monitoring.ros_topics import JOINT_PREFIX
from server.monitoring.servo_history import SERVICE as HISTORY
from server.rosbridge_clients import CallingClient

HIDDEN = "***"

# A shorter text is no token, and may stand anywhere.
LEAST_SECRET_CHARACTERS = 8

# The newest files about faults, of at most a megabyte each; they shrink to a tenth in the archive.
MAX_FAULT_FILES = 20

# Of a file that is copied; a robot.toml has a few kilobytes.
MAX_FILE_BYTES = 1_000_000

PROBLEMS = "problems.txt"

# Beginning of the members' names, and their content.
CONTENTS: Mapping[str, str] = {
    "settings.json": "every setting with its source; tokens and the names of their owners are left out",
    "versions.json": "armbridge, Python, operating system and processor",
    "packages.txt": "installed Python packages",
    "ports.json": "serial ports of this machine",
    "arm/": "robot.toml and the calibration in use",
    "server/": "the running server: the arm's state, the servos' registers and last minutes, and its last log lines",
    "faults/": "the last minute of log and joints before each of the last faults",
    "bus/": "the servos as they answer on the bus: registers, and the findings of doctor; only read",
    PROBLEMS: "what could not be had, and why",
}

# Fields and parameters whose values are secret, in JSON, TOML, URLs and zenoh's endpoints.
_SECRET_FIELD = re.compile(
    r"((?:password|passwd|passphrase|secret|authorization|private_key\w*)[\"']?\s*[=:]\s*[\"']?)[^\s\"',;&}#]+",
    re.IGNORECASE,
)
_URL_USER = re.compile(r"(\w://)[^/\s\"'@]+@")
_PRIVATE_KEY = re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(?:-----END [A-Z ]*PRIVATE KEY-----|\Z)", re.DOTALL)
_HOMES = re.compile(r"/(home|Users)/[^/\s\"':,;]+")


class Redactor:
    """Blots secrets and names of home directories out of texts."""

    def __init__(self, secrets: Iterable[str], home: Path) -> None:
        long = {secret for secret in secrets if len(secret) >= LEAST_SECRET_CHARACTERS}
        # As JSON writes them, too.
        written = {json.dumps(secret)[1:-1] for secret in long} | long
        # The longest first: one may be the beginning of another.
        self._secrets = sorted(written, key=len, reverse=True)
        homes = {str(home), str(home.resolve())} - {"/", "."}
        self._homes = [re.compile(rf"{re.escape(each)}(?![\w.-])") for each in sorted(homes, key=len, reverse=True)]

    def text(self, text: str) -> str:
        for secret in self._secrets:
            text = text.replace(secret, HIDDEN)
        text = _PRIVATE_KEY.sub(HIDDEN, text)
        text = _SECRET_FIELD.sub(rf"\g<1>{HIDDEN}", without_secrets(text))
        text = _URL_USER.sub(rf"\g<1>{HIDDEN}@", text)
        for home in self._homes:
            text = home.sub("~", text)
        return _HOMES.sub(rf"/\g<1>/{HIDDEN}", text)


class Report:
    """Members of a report, each without secrets."""

    def __init__(self, redactor: Redactor) -> None:
        self._redactor = redactor
        self._members: dict[str, bytes] = {}
        self._problems: list[str] = []

    @property
    def sizes(self) -> Mapping[str, int]:
        return {name: len(content) for name, content in self._members.items()}

    def add(self, name: str, text: str) -> None:
        self._members[self._redactor.text(name)] = self._redactor.text(text).encode()

    def add_json(self, name: str, value: object) -> None:
        self.add(name, json.dumps(value, indent=2, default=str) + "\n")

    def add_file(self, name: str, path: Path) -> None:
        with path.open("rb") as file:
            self.add(name, file.read(MAX_FILE_BYTES).decode(errors="replace"))

    def note(self, problem: str) -> None:
        self._problems.append(problem)

    @contextlib.contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Note errors within the context: the rest of the report goes on."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 - any library may fail on the machine that is reported
            self.note(f"{name}: {str(error) or type(error).__name__}")

    def archive(self) -> bytes:
        if self._problems:
            self.add(PROBLEMS, "".join(f"{problem}\n" for problem in self._problems))
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in self._members.items():
                archive.writestr(name, content)
        return packed.getvalue()


def add_settings(report: Report, settings: Settings, sources: Mapping[str, str]) -> None:
    """Add the settings; of tokens only how many there are."""
    values = settings.model_dump(mode="json")
    access = values["access"]
    for name, value in access.items():
        if name.endswith("_tokens"):
            access[name] = len(value)
    report.add_json("settings.json", {"settings": values, "sources": dict(sources)})


def add_machine(report: Report) -> None:
    with report.part("versions"):
        # Kernel, processor and WSL are in the system's name; the machine's own name is not.
        system = {"python": sys.version, "system": platform.platform(), "cores": os.cpu_count()}
        report.add_json("versions.json", {"armbridge": metadata.version("armbridge"), **system})
    with report.part("packages"):
        packages = {(each.metadata["Name"] or "?", each.version) for each in metadata.distributions()}
        report.add("packages.txt", "".join(f"{name}=={version}\n" for name, version in sorted(packages)))
    with report.part("ports"):
        report.add_json("ports.json", [_port(port) for port in list_ports.comports()])


def add_faults(report: Report, directory: Path) -> None:
    for path in sorted(directory.glob(f"{PREFIX}*.jsonl"), reverse=True)[:MAX_FAULT_FILES]:
        with report.part(f"faults/{path.name}"):
            report.add(f"faults/{path.name}", path.read_text(errors="replace"))


def _port(port: Any) -> dict[str, Any]:
    usb = None if port.vid is None else f"{port.vid:04x}:{port.pid:04x}"
    access = os.access(port.device, os.R_OK | os.W_OK)
    return {"device": port.device, "usb_id": usb, "description": port.description, "may_be_opened": access}


TIMEOUT_S = 3.0

# /diagnostics comes once a second, of a slow simulated arm more rarely.
DIAGNOSTICS_TIMEOUT_S = 6.0

MAX_ANSWER_BYTES = 5_000_000

# Member and type of each topic.
_TOPICS = {
    "/arm/state": ("arm_state", "diagnostic_msgs/DiagnosticStatus"),
    "/diagnostics": ("diagnostics", "diagnostic_msgs/DiagnosticArray"),
}


def add_server(report: Report, settings: Settings, token: str | None) -> set[Path] | None:
    """Add what the server that the settings describe answers, if it runs on this machine.

    Returns the directory of its files about faults, if it names one; None where no server answers. Raises
    WebSocketException for a server that refuses the token.
    """
    server = settings.server
    # An address of all interfaces is none to connect to.
    host = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}.get(server.host, server.host)  # noqa: S104
    address = f"[{host}]:{server.port}" if ":" in host else f"{host}:{server.port}"
    context: ssl.SSLContext | None = None
    if server.tls_certificate is not None:
        # Its certificate may have another name than the address; it is the one in the server's own settings.
        context = ssl.create_default_context(cafile=str(server.tls_certificate))
        context.check_hostname = False
    try:
        websocket = connect(
            f"{'ws' if context is None else 'wss'}://{address}/",
            ssl=context,
            additional_headers={} if token is None else {"Authorization": f"Bearer {token}"},
            open_timeout=TIMEOUT_S,
            close_timeout=TIMEOUT_S,
            proxy=None,
            max_size=MAX_ANSWER_BYTES,
        )
    except OSError:
        report.note(f"server: none answers at {address}")
        return None
    with websocket:
        statuses = _add_answers(report, CallingClient(websocket))
    values = [each for status in statuses for each in status["values"]]
    return {Path(each["value"]).parent for each in values if each["key"] == "fault_file"}


def _add_answers(report: Report, client: CallingClient) -> list[dict[str, Any]]:
    """Add the answers of a server; return the statuses of its arm and joints."""
    until_s = time.monotonic() + DIAGNOSTICS_TIMEOUT_S
    for topic, (_, type_name) in _TOPICS.items():
        client.subscribe(topic, type_name)
    with report.part("server/log.txt"):
        report.add("server/log.txt", client.call(LOG, {})["message"] + "\n")
    while len(client.messages) < len(_TOPICS) and (left_s := until_s - time.monotonic()) > 0.0:
        client.receive(left_s)
    for topic, message in client.messages.items():
        report.add_json(f"server/{_TOPICS[topic][0]}.json", message)
    if silent := _TOPICS.keys() - client.messages.keys():
        report.note(f"server: {', '.join(sorted(silent))} not heard in {DIAGNOSTICS_TIMEOUT_S:g} s")
    statuses: list[dict[str, Any]] = client.messages.get("/diagnostics", {}).get("status", [])
    joints = [each["name"].removeprefix(JOINT_PREFIX) for each in statuses[1:]]
    report.add_json("server/servo_history.json", {joint: client.call(HISTORY, {"joint": joint}) for joint in joints})
    return statuses
