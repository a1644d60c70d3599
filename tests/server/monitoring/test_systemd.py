import logging
import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from server.monitoring.systemd import SystemdNotifier


class Systemd:
    """The socket of systemd, which hears what services say."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self.socket.settimeout(30.0)

    def heard(self) -> list[str]:
        return self.socket.recv(4096).decode().splitlines()


@pytest.fixture
def notifier(systemd: Systemd) -> Iterator[SystemdNotifier]:
    made = SystemdNotifier(systemd.address)
    yield made
    made.close()


@pytest.fixture(params=["path", "abstract"])
def systemd(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Systemd]:
    found = Systemd(str(tmp_path / "notify") if request.param == "path" else f"@armbridge-test-{os.getpid()}")
    with found.socket:
        yield found


def test_systemd_gets_notifications_in_its_format(systemd: Systemd, notifier: SystemdNotifier) -> None:
    # A status cannot smuggle in another assignment.
    notifier.notify_status("starting\nREADY=1")
    notifier.notify_ready("ready")
    notifier.notify_watchdog()
    notifier.notify_stopping()
    assert [systemd.heard() for _ in range(4)] == [
        ["STATUS=starting READY=1"],
        ["READY=1", "STATUS=ready"],
        ["WATCHDOG=1"],
        ["STOPPING=1", "STATUS=stopping"],
    ]


def test_one_that_does_not_read_holds_nobody_up(notifier: SystemdNotifier) -> None:
    for _ in range(5000):
        notifier.notify_watchdog()
        notifier.notify_status("there is news")
    notifier.close()
    notifier.notify_watchdog()


def test_without_one_nothing_is_told() -> None:
    notifier = SystemdNotifier.from_environment({}, 7)
    notifier.notify_ready("ready")
    assert notifier.watchdog_s == 0.0


def test_an_unreachable_notifier_is_logged_and_passed_over(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    notifier = SystemdNotifier(str(tmp_path / "nobody"))
    notifier.notify_ready("ready")
    assert "NOTIFY_SOCKET" in caplog.text


WATCHED: list[tuple[dict[str, str], float]] = [
    ({"WATCHDOG_USEC": "2500000", "WATCHDOG_PID": "7"}, 2.5),
    ({"WATCHDOG_USEC": "2500000"}, 2.5),
    ({"WATCHDOG_USEC": "2500000", "WATCHDOG_PID": "8"}, 0.0),
    ({"WATCHDOG_USEC": "often", "WATCHDOG_PID": "7"}, 0.0),
    ({}, 0.0),
]


def test_the_watchdog_is_for_the_named_process(systemd: Systemd) -> None:
    for variables, watchdog_s in WATCHED:
        notifier = SystemdNotifier.from_environment({"NOTIFY_SOCKET": systemd.address, **variables}, 7)
        assert notifier.watchdog_s == watchdog_s, variables
        notifier.close()


def test_children_do_not_inherit_the_variables(monkeypatch: pytest.MonkeyPatch, systemd: Systemd) -> None:
    variables = {"NOTIFY_SOCKET": systemd.address, "WATCHDOG_USEC": "1", "WATCHDOG_PID": str(os.getpid())}
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    notifier = SystemdNotifier.from_environment()
    assert not set(variables) & set(os.environ)
    assert notifier.watchdog_s == pytest.approx(1e-6)
    notifier.close()
