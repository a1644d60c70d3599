"""Classroom: a server with a simulated arm for each student, forked from one process, and one host of planners.

This process loads every module and the robot once; the servers and their arms' processes are forks of it, which share
that memory. Planners are processes of the host, and the servers take turns with them.
"""

import csv
import gc
import importlib
import io
import logging
import os
import secrets
import signal
import socket
import tempfile
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
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
from robot import files
from robot.processes import OF_SERVICE_MANAGER, ForkedProcess, RestartDelay, StartedChild
from robot.template import end_with_parent
from server.access.settings import check_token
from server.app import Inherited, serve
from server.arm.setup import Description, arm_config, check_parameters
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


def places(count: int, first_port: int, folder: Path) -> list[Student]:
    """Make a place for each student, with ports in a row; students in the folder's list keep their tokens.

    Raises ConfigurationError for ports that there are not, StartError for a list that cannot be read.
    """
    last_port = first_port + count - 1
    if not 0 < first_port <= last_port <= MAX_PORT:
        raise ConfigurationError(
            f"--port: {count} students need ports in a row, {first_port} to {last_port}: there are 1 to {MAX_PORT}"
        )
    known = read_tokens(folder / LIST_FILE)
    names = [f"student{number:02d}" for number in range(1, count + 1)]
    return [
        Student(name, first_port + index, known.get(name) or new_token(), folder / name)
        for index, name in enumerate(names)
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


SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGCHLD)

# A server takes 2.6 s at most, and the end of its arm up to 20 s where it is parked; twenty of them share the cores.
END_TIMEOUT_S = 40.0

# Interval of looking for members that are due again.
CHECK_S = 0.2


@dataclass
class Member:
    """Process to keep running; its log goes to a file, emptied at the first start, or to the terminal."""

    name: str
    run: Callable[[], None]
    log_file: Path | None = None
    _process: ForkedProcess | None = None
    _started_s: float = 0.0
    _due_s: float = 0.0
    _delay: RestartDelay = field(default_factory=RestartDelay)
    _starts: int = 0

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    def start_if_due(self, now_s: float) -> None:
        if self._process is not None or now_s < self._due_s:
            return
        self._started_s = now_s
        self._starts += 1
        try:
            self._process = ForkedProcess(self._run_forked)
        except OSError as error:
            self._due_s = now_s + self._delay.after(0.0)
            log.warning("%s cannot be started: %s", self.name, error)
        else:
            log.info("%s: process %d", self.name, self._process.pid)

    def reap(self, now_s: float) -> None:
        """Notice the end of the process; it becomes due again, later each time."""
        if self._process is None or (code := self._process.poll()) is None:
            return
        self._process = None
        delay_s = self._delay.after(now_s - self._started_s)
        self._due_s = now_s + delay_s
        ending = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
        log.warning("%s has ended (%s) and is started again in %.1f s", self.name, ending, delay_s)

    def ended(self) -> bool:
        return self._process is None or self._process.poll() is not None

    def signal(self, number: signal.Signals) -> None:
        if self._process is not None and not self.ended():
            os.kill(self._process.pid, number)

    def _run_forked(self) -> None:
        end_with_parent(os.getppid(), signal.SIGTERM)
        for number in SIGNALS:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, ())
        if self.log_file is not None:
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | (os.O_TRUNC if self._starts == 1 else 0)
            descriptor = os.open(self.log_file, flags, 0o600)
            for standard in (1, 2):
                os.dup2(descriptor, standard)
            os.close(descriptor)
        self.run()


def supervise(members: Sequence[Member]) -> None:
    """Run all members until SIGINT or SIGTERM, and start each again that ends before.

    This process has no threads and no event loop, so that a fork of it is whole at any time. It waits for signals: the
    end of a child (SIGCHLD), or its own. What it has loaded before the first fork is in memory once for all.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    # A collection in a child would write to every object, and so copy what it shares with the others.
    gc.collect()
    gc.freeze()
    try:
        while not _must_end():
            now_s = time.monotonic()
            for member in members:
                member.reap(now_s)
                member.start_if_due(now_s)
    finally:
        _end(members)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _must_end() -> bool:
    """Wait for a signal, for a while; return True when it asks for the end."""
    received = signal.sigtimedwait(SIGNALS, CHECK_S)
    return received is not None and received.si_signo != signal.SIGCHLD


def _end(members: Iterable[Member]) -> None:
    """End all members: in good order, at once after a second signal, and by force when they take too long."""
    running = [member for member in members if not member.ended()]
    for member in running:
        member.signal(signal.SIGTERM)
    until_s = time.monotonic() + END_TIMEOUT_S
    while (running := [member for member in running if not member.ended()]) and time.monotonic() < until_s:
        if _must_end():
            for member in running:
                member.signal(signal.SIGTERM)
    for member in running:
        log.warning("%s does not end and is killed", member.name)
        member.signal(signal.SIGKILL)


log = logging.getLogger("armbridge.classroom")

# Questions that are answered at the same time: among them are checks of motions under way, which must not wait.
QUESTIONS = 2


def run_classroom(settings: Settings, count: int, planners: int, folder: Path, with_physics: Collection[str]) -> None:
    """Run a classroom of ``count`` students until a signal; some, by their names, have physics.

    Raises ConfigurationError for settings, StartError for a port or the folder, FileLockedError for a folder in use.
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
    students = places(count, settings.server.port, folder)
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
    # A second classroom with this folder would replace the list, and share the students' files.
    with files.locked(file, 0.0), tempfile.TemporaryDirectory(prefix="armbridge") as private:
        write_list(file, students, teacher_token, host, tls=settings.server.tls_certificate is not None)
        first, last = students[0].port, students[-1].port
        log.info("%d arms on ports %d to %d; names, addresses and tokens are in %s", len(students), first, last, file)
        inherited = Inherited(description, Path(private) / "planners")

        def serve_planners() -> None:
            memory_bytes = settings.planning.memory_limit_bytes
            shared = PlannerHost(description.robot, inherited.planners, count, planners, QUESTIONS, memory_bytes)
            uvloop.run(run_until_signal(shared.run()))

        planner_host = Member("the planners", serve_planners, folder / "planners.log")
        servers = [_server_member(student, own, inherited) for student, own in zip(students, all_settings, strict=True)]
        supervise([planner_host, *servers])
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
