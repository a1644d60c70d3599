"""Classroom: a server with a simulated arm for each student, forked from one process, and one host of planners.

This process loads every module and the robot once; the servers and their arms' processes are forks of it, which share
that memory. Planners are processes of the host, and the servers take turns with them. Each student has a port, a
folder and a token, on the list that the teacher hands out.
"""

import csv
import http.client
import importlib
import logging
import os
import secrets
import socket
import ssl
import tempfile
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import uvloop
from pydantic import SecretStr

# The last two are loaded ahead for the arms' processes, which would each load their hardware's modules.
import robot.control.loop
import robot.emulator.feetech
import robot.hardware.ideal
from planners.shared_pool import PlannerHost
from robot.processes import OF_SERVICE_MANAGER, StartedChild
from server.access.settings import check_token
from server.app import Inherited, serve
from server.arm.setup import Description, arm_config, check_parameters
from server.classroom.supervisor import Member, supervise
from server.config import Settings
from server.errors import ConfigurationError, StartError
from server.lifecycle import run_until_signal

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
    temporary = file.with_suffix(".new")
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(descriptor, "w", newline="") as lines:
            rows = csv.writer(lines, lineterminator="\n")
            rows.writerow(COLUMNS)
            rows.writerows((each.name, f"{scheme}://{shown}:{each.port}", each.token) for each in students)
            rows.writerow((TEACHER, f"{scheme}://{shown}:{students[0].port}", teacher_token))
        temporary.replace(file)
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


log = logging.getLogger("armbridge.classroom")

# Questions that are answered at the same time: checks of motions under way among them, which others' must not hold up.
QUESTIONS = 2

READY_TIMEOUT_S = 0.3


def run_classroom(
    settings: Settings, count: int, planners: int, folder: Path, with_physics: Collection[str] = ()
) -> None:
    """Run a classroom of ``count`` students until a signal; some, by their names, have physics.

    Raises ConfigurationError for settings, StartError for a port or the folder.
    """
    _check_settings(settings)
    description = Description.read(settings.arm)
    physics = settings.model_copy(
        update={"simulation": settings.simulation.model_copy(update={"kind": "physics"})} if with_physics else {}
    )
    if arm_config(physics, description).hardware.physics:
        # MuJoCo is in memory once for all.
        importlib.import_module("robot.physics.ideal_arm")
        importlib.import_module("robot.physics.servo_joints")
    check_parameters(settings.moveit, description.robot)
    host, file = settings.server.host, folder / LIST_FILE
    students = places(count, settings.server.port, folder, host)
    if unknown := set(with_physics) - {student.name for student in students}:
        raise ConfigurationError(
            f"--physics: there is no {min(unknown)!r}: the students are {students[0].name} to {students[-1].name}"
        )
    teacher_token = read_tokens(file).get(TEACHER) or new_token()
    ports = {student.name: student.port for student in students}
    all_settings = [
        student.settings(physics if student.name in with_physics else settings, teacher_token, ports)
        for student in students
    ]
    _check_ports(host, students)
    _make_folders(folder, students)
    write_list(file, students, teacher_token, host, tls=settings.server.tls_certificate is not None)
    with tempfile.TemporaryDirectory(prefix="armbridge") as private:
        inherited = Inherited(description, Path(private) / "planners")

        def serve_planners() -> None:
            memory_bytes = settings.planning.memory_limit_bytes
            shared = PlannerHost(description.robot, inherited.planners, count, planners, QUESTIONS, memory_bytes)
            uvloop.run(run_until_signal(shared.run()))

        planner_host = Member("the planners", serve_planners, folder / "planners.log")
        servers = [_server_member(student, own, inherited) for student, own in zip(students, all_settings, strict=True)]
        supervise([planner_host, *servers], _Readiness(students, host, file, tls=bool(settings.server.tls_certificate)))
    log.info("stopped")


def _server_member(student: Student, settings: Settings, inherited: Inherited) -> Member:
    def run() -> None:
        for name in OF_SERVICE_MANAGER:
            os.environ.pop(name, None)
        arm_process = StartedChild("", body=robot.control.loop.run_forked)
        try:
            serve(settings, arm_process, inherited)
        finally:
            arm_process.close()

    return Member(student.name, run, student.folder / "server.log")


def _check_settings(settings: Settings) -> None:
    for section, name in (("arm", "serial"), ("emulator", "control"), ("emulator", "write_log")):
        if (value := getattr(getattr(settings, section), name)) is not None:
            raise ConfigurationError(
                f"{section}.{name}: the arms of a classroom are simulated, and {value} is for one arm; leave it out"
            )
    if settings.server.tcp_port is not None:
        raise ConfigurationError(
            f"server.tcp_port: the servers of a classroom have one port each, and {settings.server.tcp_port} is for one"
            " server; leave it out"
        )
    if settings.zenoh.mode != "off":
        raise ConfigurationError(
            f"zenoh.mode: must be off in a classroom, not {settings.zenoh.mode}: its servers have the same topics, "
            "which would mix"
        )


def _check_ports(host: str, students: Sequence[Student]) -> None:
    """Refuse a port that is in use, before anything is started."""
    for student in students:
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, student.port))
            except OSError as error:
                message = f"port {student.port}, for {student.name}, cannot be taken: {error}; choose others by --port"
                raise StartError(message) from error


def _make_folders(folder: Path, students: Sequence[Student]) -> None:
    for each in (folder, *(student.folder for student in students)):
        try:
            each.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise StartError(f"{each}: the folder cannot be made: {error}") from error


class _Readiness:
    """Logs once when all servers are ready."""

    def __init__(self, students: Sequence[Student], host: str, file: Path, *, tls: bool) -> None:
        self._waited = list(students)
        self._host = "127.0.0.1" if host in ("0.0.0.0", "") else "::1" if host == "::" else host  # noqa: S104 - compared
        self._file = file
        self._tls = tls
        self._first, self._last = students[0], students[-1]
        self._count = len(students)
        self._began_s = time.monotonic()

    def __call__(self) -> None:
        """Look which servers are ready by now, until one is not; without effect once all are."""
        if not self._waited:
            return
        while self._waited and self._ready(self._waited[0]):
            self._waited.pop(0)
        if not self._waited:
            log.info(
                "the classroom is ready after %.1f s: %d arms on ports %d to %d; names, addresses and tokens are in %s",
                time.monotonic() - self._began_s,
                self._count,
                self._first.port,
                self._last.port,
                self._file,
            )

    def _ready(self, student: Student) -> bool:
        if self._tls:
            # This machine asks itself; the certificate names others' way here.
            context = ssl._create_unverified_context()  # noqa: S323, SLF001
            connection: http.client.HTTPConnection = http.client.HTTPSConnection(
                self._host, student.port, timeout=READY_TIMEOUT_S, context=context
            )
        else:
            connection = http.client.HTTPConnection(self._host, student.port, timeout=READY_TIMEOUT_S)
        try:
            connection.request("GET", "/readyz")
            return connection.getresponse().status == http.client.OK
        except (OSError, http.client.HTTPException):
            return False
        finally:
            connection.close()
