"""A server under systemd: its notifications, signals and log."""

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from harness.server import RunningServer
from harness.waiting import wait_until
from tests.helpers.systemd import Systemd


@pytest.fixture(scope="module")
def service(systemd: Systemd) -> Iterator[RunningServer]:
    """A server as systemd starts it, with JSON for journald's readers."""
    settings = {"NOTIFY_SOCKET": systemd.address, "WATCHDOG_USEC": "300000", "ARMBRIDGE_SERVER__LOG_FORMAT": "json"}
    with RunningServer(settings=settings) as running:
        yield running


def test_systemd_hears_that_the_server_is_ready_and_repeatedly_alive(service: RunningServer, systemd: Systemd) -> None:
    assert systemd.has_heard("READY=1")
    assert systemd.has_heard("WATCHDOG=1", times=systemd.heard.count("WATCHDOG=1") + 3)


def children_of(service: RunningServer) -> list[int]:
    return sorted(each.pid for each in psutil.Process(service.process.pid).children(recursive=True))


def ignored_by(pid: int) -> int:
    """The signals that a process ignores, the first in the lowest bit (SigIgn in proc_pid_status(5))."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("SigIgn:")).split()[1], 16)


def test_a_signal_to_all_processes_changes_the_level_and_ends_none(service: RunningServer) -> None:
    # The arm, and two planners with their template.
    wait_until(lambda: len(children_of(service)) == 4)
    children = children_of(service)
    for child in children:
        # Children do not speak for the server.
        assert b"NOTIFY_SOCKET" not in Path(f"/proc/{child}/environ").read_bytes()
        # Planners ignore the signal once they have loaded their libraries.
        wait_until(lambda child=child: ignored_by(child) >> signal.SIGUSR1 - 1 & 1)
    for words in ("is debug now", "again what the settings say"):
        for pid in (service.process.pid, *children):
            os.kill(pid, signal.SIGUSR1)
        assert service.has_logged(words)
    assert children_of(service) == children


def test_every_line_of_the_log_is_json_and_systemd_hears_that_the_server_ends(
    service: RunningServer, systemd: Systemd
) -> None:
    assert service.has_logged("robot.control.loop")
    lines = [json.loads(line) for line in list(service.lines)]
    assert {line["process"] for line in lines} >= {"server", "robot.control.loop"}
    assert {"time", "level", "logger", "message", "process", "pid"} <= set.intersection(*(set(line) for line in lines))
    assert service.end(signal.SIGTERM)[0] == 0
    assert systemd.has_heard("STOPPING=1")
