"""Health, the report and systemd."""

import dataclasses
import io
import json
import logging
import os
import socket
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from harness.waiting import TIMEOUT_S
from robot.faults import FaultCode
from robot.messages import Mode
from server.config import Settings
from server.monitoring import report as report_module
from server.monitoring.health import ARM_SILENT_S, ARM_STALE_S, Sources, check_health
from server.monitoring.report import PROBLEMS, Redactor, Report, add_faults, add_machine, add_settings
from server.monitoring.systemd import SystemdNotifier
from tests.server.monitoring import watched_parts
from tests.server.monitoring.watched_parts import WatchedArm, WatchedPlanners, arm_state


@pytest.fixture
def sources() -> Sources:
    return watched_parts.watched_sources()


def test_a_server_at_work_is_live_and_ready_and_has_nothing_to_say(sources: Sources) -> None:
    # The second arm is simulated, and starved by a busy machine.
    for arm in (sources.arm, WatchedArm(arm_state(), 4.9, state_max_age_s=5.0)):
        health = check_health(replace(sources, arm=arm))
        assert (health.live, health.ready, health.reasons) == (True, True, ())


NOT_READY: list[tuple[dict[str, Any], str]] = [
    (dataclasses.asdict(Sources()), "the server is starting"),
    ({"started": False}, "the server is starting"),
    ({"stopping": True}, "the server is stopping"),
    ({"arm": WatchedArm(arm_state(Mode.DISCONNECTED))}, "the arm is not connected"),
    ({"arm": WatchedArm(arm_state(Mode.CONNECTED))}, "the servos are being checked, or were refused"),
    ({"arm": WatchedArm(arm_state(Mode.FAULT, FaultCode.OVERHEATED))}, "the arm has a fault: overheated"),
    ({"arm": WatchedArm(arm_state(), ARM_STALE_S + 0.1)}, "the last state of the arm is older than 1.5 s"),
    ({"arm": WatchedArm(arm_state(), 5.1, state_max_age_s=5.0)}, "the last state of the arm is older than 5 s"),
    ({"planners": WatchedPlanners(loaded_count=0)}, "the planners are loading"),
    ({"planners": WatchedPlanners(load_failure="no module in /home/me")}, "the planners cannot be started"),
]


def test_an_obstacle_to_goals_is_a_reason_to_be_unready(sources: Sources) -> None:
    for changes, reason in NOT_READY:
        health = check_health(replace(sources, **changes))
        assert (health.live, health.ready, health.reasons) == (True, False, (reason,)), changes
    # A relaxed arm is there for those who enable it.
    assert check_health(replace(sources, arm=WatchedArm(arm_state(Mode.RELAXED)))).ready


def test_a_long_silence_of_the_arm_process_makes_the_server_dead_unless_it_starts_or_stops(sources: Sources) -> None:
    sources.arm = WatchedArm(arm_state(), ARM_SILENT_S + 0.1)
    health = check_health(sources)
    reason = "the arm process has been silent for more than 10 s"
    assert (health.live, health.ready, health.reasons) == (False, False, (reason,))
    for changes in ({"started": False}, {"stopping": True}):
        assert check_health(replace(sources, **changes)).live, changes


def test_the_answer_over_http_has_the_status_for_monitors_and_no_device_file_or_address(sources: Sources) -> None:
    health = check_health(replace(sources, started=False))
    assert [int(health.response(good=good).status) for good in (True, False)] == [200, 503]
    told = {"live": True, "ready": False, "reasons": ["the server is starting"]}
    assert json.loads(health.response(good=False).body) == told
    sources.arm = WatchedArm(arm_state(Mode.DISCONNECTED, FaultCode.BUS_LOST, "no /dev/ttySECRET"))
    sources.planners = WatchedPlanners(load_failure="cannot read /home/SECRET")
    assert b"SECRET" not in check_health(sources).response(good=False).body


TOKEN = "one-0123456789abcdef"
LONGER = f"{TOKEN}-and-more"
QUOTED = 'quoted"and\\0123456789'
HOME = Path("/srv/people/ada")


@pytest.fixture
def report() -> Report:
    return Report(Redactor([TOKEN], HOME))


def members(report: Report) -> dict[str, str]:
    with zipfile.ZipFile(io.BytesIO(report.archive())) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}


SECRETS = {
    f"it was {TOKEN}!": "it was ***!",
    # One that another one begins with, one that JSON escapes, and one of somebody else in an address.
    LONGER: "***",
    json.dumps({"x": QUOTED}): '{"x": "***"}',
    "GET /?token=other-secret&x=1": "GET /?token=***&x=1",
    "Authorization: Bearer abc.def": "Authorization: *** ***",
    '{"password": "hunter2", "x": 1}': '{"password": "***", "x": 1}',
    "socket://ada:hunter2@host:4000": "socket://***@host:4000",
    "tls/host:7447#connect_private_key_base64=AAAA;x=1": "tls/host:7447#connect_private_key_base64=***;x=1",
    "-----BEGIN RSA PRIVATE KEY-----\nAAAA\n-----END RSA PRIVATE KEY-----\n": "***\n",
    # The home directory, a folder whose name begins alike, and homes of others.
    "/srv/people/ada/arm.json": "~/arm.json",
    "/srv/people/ada2/arm.json": "/srv/people/ada2/arm.json",
    "/home/grace/arm.json and /home/grace": "/home/***/arm.json and /home/***",
}


def test_secrets_are_blotted_out() -> None:
    redactor = Redactor([TOKEN, LONGER, QUOTED], HOME)
    assert {text: redactor.text(text) for text in SECRETS} == SECRETS


def test_every_member_is_without_secrets(report: Report, tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(f"# {TOKEN}")
    report.add("server/log.txt", TOKEN)
    report.add_json("settings.json", {"x": [TOKEN]})
    report.add_file("arm/robot.toml", file)
    report.note(TOKEN)
    told = members(report)
    assert set(told) == {"server/log.txt", "settings.json", "arm/robot.toml", PROBLEMS}
    assert TOKEN not in "".join(told.values())


def test_settings_have_neither_tokens_nor_the_names_of_their_owners(report: Report) -> None:
    values: dict[str, Any] = {"access": {"token": TOKEN, "view_tokens": {"grace": "two-0123456789abcdef"}}}
    add_settings(report, Settings(**values), {"access.token": "file"})
    told = members(report)["settings.json"]
    assert "0123456789abcdef" not in told
    assert "grace" not in told
    assert json.loads(told)["settings"]["access"]["view_tokens"] == 1
    assert json.loads(told)["sources"] == {"access.token": "file"}


def test_the_machine_is_told_by_versions_packages_and_ports_and_what_fails_is_noted(report: Report) -> None:
    add_machine(report)
    told = members(report)
    assert PROBLEMS not in told
    versions = json.loads(told["versions.json"])
    assert versions["armbridge"]
    assert versions["system"]
    assert "numpy==" in told["packages.txt"]
    assert isinstance(json.loads(told["ports.json"]), list)
    with report.part("bus"):
        raise LookupError
    with report.part("arm"):
        report.add("arm/robot.toml", "name = 'x'")
    told = members(report)
    assert told[PROBLEMS] == "bus: LookupError\n"
    assert "arm/robot.toml" in told


def test_the_newest_fault_files_are_included(report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_module, "MAX_FAULT_FILES", 2)
    (tmp_path / "other.jsonl").write_text("somebody else's")
    for number in range(4):
        (tmp_path / f"fault-{number}.jsonl").write_text("x" * 100)
    add_faults(report, tmp_path)
    told = members(report)
    assert [name for name in told if name.startswith("faults/")] == ["faults/fault-3.jsonl", "faults/fault-2.jsonl"]
    add_faults(none := Report(Redactor([], HOME)), tmp_path / "none")
    assert members(none) == {}


class Systemd:
    """The socket of systemd, which hears what services say."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self.socket.settimeout(TIMEOUT_S)

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
    notifier.notify_ready()
    notifier.notify_watchdog()
    notifier.notify_stopping()
    assert [systemd.heard() for _ in range(3)] == [["READY=1"], ["WATCHDOG=1"], ["STOPPING=1"]]


def test_one_that_does_not_read_holds_nobody_up(notifier: SystemdNotifier) -> None:
    for _ in range(5000):
        notifier.notify_watchdog()
    notifier.close()
    notifier.notify_watchdog()


def test_without_one_nothing_is_told_and_a_lost_one_is_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    notifier = SystemdNotifier.from_environment({}, 7)
    notifier.notify_ready()
    assert notifier.watchdog_s == 0.0
    caplog.set_level(logging.WARNING)
    notifier = SystemdNotifier(str(tmp_path / "nobody"))
    notifier.notify_ready()
    assert "NOTIFY_SOCKET" in caplog.text


WATCHED: list[tuple[dict[str, str], float]] = [
    ({"WATCHDOG_USEC": "2500000", "WATCHDOG_PID": "7"}, 2.5),
    ({"WATCHDOG_USEC": "2500000"}, 2.5),
    ({"WATCHDOG_USEC": "2500000", "WATCHDOG_PID": "8"}, 0.0),
    ({"WATCHDOG_USEC": "often", "WATCHDOG_PID": "7"}, 0.0),
    ({}, 0.0),
]


def test_the_watchdog_is_of_one_process_and_no_child(systemd: Systemd, monkeypatch: pytest.MonkeyPatch) -> None:
    for variables, watchdog_s in WATCHED:
        notifier = SystemdNotifier.from_environment({"NOTIFY_SOCKET": systemd.address, **variables}, 7)
        assert notifier.watchdog_s == watchdog_s, variables
        notifier.close()
    variables = {"NOTIFY_SOCKET": systemd.address, "WATCHDOG_USEC": "1", "WATCHDOG_PID": str(os.getpid())}
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    notifier = SystemdNotifier.from_environment()
    assert not set(variables) & set(os.environ)
    assert notifier.watchdog_s == pytest.approx(1e-6)
    notifier.close()
