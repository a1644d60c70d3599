"""Classroom: a server with a simulated arm for each student, forked from one process, and one host of planners.

This process loads every module and the robot once; the servers and their arms' processes are forks of it, which share
that memory. Planners are processes of the host, and the servers take turns with them.
"""

import http.client
import importlib
import logging
import os
import socket
import ssl
import tempfile
import time
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import uvloop

# The last two are loaded ahead for the arms' processes, which would each load their hardware's modules.
import robot.control.loop
import robot.emulator.feetech
import robot.hardware.ideal
from planners.shared_pool import PlannerHost
from robot.processes import OF_SERVICE_MANAGER, StartedChild
from server.app import Inherited, serve
from server.arm.setup import Description, arm_config, check_parameters
from server.classroom.students import LIST_FILE, TEACHER, Student, new_token, places, read_tokens, write_list
from server.classroom.supervisor import Member, supervise
from server.config import Settings
from server.errors import ConfigurationError, StartError
from server.lifecycle import run_until_signal

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
        supervise(
            [planner_host, *servers], _log_when_ready(students, host, file, tls=bool(settings.server.tls_certificate))
        )
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


def _log_when_ready(students: Sequence[Student], host: str, file: Path, *, tls: bool) -> Callable[[], None]:
    """Return a check which servers are ready by now, until one is not; it logs once that all are."""
    began_s, waited = time.monotonic(), list(students)
    asked = "127.0.0.1" if host in ("0.0.0.0", "") else "::1" if host == "::" else host  # noqa: S104 - compared

    def check() -> None:
        while waited and _is_ready(asked, waited[0].port, tls=tls):
            waited.pop(0)
            if not waited:
                place = f"{len(students)} arms on ports {students[0].port} to {students[-1].port}"
                ready_s = time.monotonic() - began_s
                log.info(
                    "the classroom is ready after %.1f s: %s; names, addresses and tokens are in %s",
                    ready_s,
                    place,
                    file,
                )

    return check


def _is_ready(host: str, port: int, *, tls: bool) -> bool:
    connection = http.client.HTTPConnection(host, port, timeout=READY_TIMEOUT_S)
    if tls:
        # This machine asks itself; the certificate names others' way here.
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        connection = http.client.HTTPSConnection(host, port, timeout=READY_TIMEOUT_S, context=context)
    try:
        connection.request("GET", "/readyz")
        return connection.getresponse().status == http.client.OK
    except (OSError, http.client.HTTPException):
        return False
    finally:
        connection.close()
