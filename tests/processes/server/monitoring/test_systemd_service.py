"""A server under systemd: its notifications, signals and log."""

import json
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


def test_children_do_not_speak_for_the_server(service: RunningServer) -> None:
    def children() -> list[psutil.Process]:
        return psutil.Process(service.process.pid).children(recursive=True)

    # The arm, and two planners with their template.
    wait_until(lambda: len(children()) == 4)
    for child in children():
        assert b"NOTIFY_SOCKET" not in Path(f"/proc/{child.pid}/environ").read_bytes()


def test_every_line_of_the_log_is_json_and_systemd_hears_that_the_server_ends(
    service: RunningServer, systemd: Systemd
) -> None:
    assert service.has_logged("robot.control.loop")
    lines = [json.loads(line) for line in list(service.lines)]
    assert {line["process"] for line in lines} >= {"server", "robot.control.loop"}
    assert {"time", "level", "logger", "message", "process", "pid"} <= set.intersection(*(set(line) for line in lines))
    assert service.end(signal.SIGTERM)[0] == 0
    assert systemd.has_heard("STOPPING=1")
