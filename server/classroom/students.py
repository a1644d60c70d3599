"""Students of a classroom: a port, a folder and a token each, and the list of them that a teacher hands out."""

import csv
import io
import secrets
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Any

from pydantic import SecretStr

from robot import files
from server.access.settings import check_token
from server.config import Settings
from server.errors import ConfigurationError, StartError

LIST_FILE = "students.csv"
COLUMNS = ("name", "url", "token")

# The teacher's line in the list; its token is good at every student's server, with the role admin.
TEACHER = "teacher"

TOKEN_BYTES = 24
MAX_PORT = 65_535


@dataclass(frozen=True)
class Student:
    """Place of one student."""

    name: str
    port: int
    token: str
    folder: Path

    def settings(self, base: Settings, teacher_token: str, ports: Mapping[str, int]) -> Settings:
        """Return the settings of the student's server, which lets the pages of all servers in.

        Raises ConfigurationError for a token or a name given twice.
        """
        access, recording = base.access, base.recording
        operators, admins = dict(access.operate_tokens), dict(access.admin_tokens)
        if self.name in operators or TEACHER in admins:
            raise ConfigurationError(f"access: {self.name} and {TEACHER} are names of a classroom's own tokens")
        operators[self.name], admins[TEACHER] = SecretStr(self.token), SecretStr(teacher_token)
        file = recording.file and self.folder / recording.file.name
        return base.model_copy(
            update={
                "server": base.server.model_copy(update={"port": self.port, "classroom": dict(ports)}),
                "access": access.model_copy(update={"operate_tokens": operators, "admin_tokens": admins}),
                "scene": base.scene.model_copy(update={"file": self.folder / "scene.json"}),
                "goals": base.goals.model_copy(update={"named_states_file": self.folder / "named_states.json"}),
                "recording": recording.model_copy(update={"file": file}),
                "diagnostics": base.diagnostics.model_copy(update={"fault_directory": self.folder / "faults"}),
            }
        )


def places(count: int, first_port: int, folder: Path, host: str) -> list[Student]:
    """Make a place for each student; who is in the folder's list keeps the token.

    Args:
        first_port: port of the first one, the others follow; 0 takes free ones.

    Raises:
        ConfigurationError: there are not enough ports.
        StartError: the list cannot be read.
    """
    if first_port and (last_port := first_port + count - 1) > MAX_PORT:
        raise ConfigurationError(
            f"--port: {count} students need the ports {first_port} to {last_port}, there are none above {MAX_PORT}"
        )
    ports = range(first_port, first_port + count) if first_port else _free_ports(count, host)
    known = read_tokens(folder / LIST_FILE)
    names = [f"student{number:02d}" for number in range(1, count + 1)]
    return [
        Student(name, port, known.get(name) or new_token(), folder / name)
        for name, port in zip(names, ports, strict=True)
    ]


def new_token() -> str:
    return secrets.token_hex(TOKEN_BYTES)


def read_tokens(file: Path) -> dict[str, str]:
    """Read the tokens of an earlier run by name; none without a list."""
    try:
        with file.open(newline="") as lines:
            rows: list[dict[str, Any]] = list(csv.DictReader(lines))
        tokens = {row["name"]: row["token"] for row in rows}
        for name, token in tokens.items():
            check_token(token, f"the token of {name} ")
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, csv.Error, KeyError, TypeError, ValueError) as error:
        raise StartError(f"{file}: is no list of students ({error}); move it away, and new tokens are made") from error
    return tokens


def write_list(file: Path, students: Sequence[Student], teacher_token: str, host: str, *, tls: bool) -> None:
    """Write a line for each student and one for the teacher, readable by the user alone."""
    shown = reachable_name(host)
    scheme = "wss" if tls else "ws"
    owners = [*((each.name, each.port, each.token) for each in students), (TEACHER, students[0].port, teacher_token)]
    lines = io.StringIO()
    rows = csv.writer(lines, lineterminator="\n")
    rows.writerows([COLUMNS, *((name, f"{scheme}://{shown}:{port}", token) for name, port, token in owners)])
    try:
        files.replace(file, lines.getvalue().encode(), 0o600)
    except OSError as error:
        raise StartError(f"{file}: cannot be written: {error}") from error


def reachable_name(host: str) -> str:
    """Return the name by which others reach an address: this machine's for an address that stands for all."""
    try:
        address = ip_address(host)
    except ValueError:
        return host
    if address.is_unspecified:
        return socket.gethostname()
    return f"[{host}]" if address.version == 6 else host


def _free_ports(count: int, host: str) -> list[int]:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    found = [socket.socket(family) for _ in range(count)]
    try:
        for each in found:
            each.bind((host, 0))
        return [int(each.getsockname()[1]) for each in found]
    except OSError as error:
        raise StartError(f"no free port on {host}: {error}") from error
    finally:
        for each in found:
            each.close()
