from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from prometheus_client import Histogram
from prometheus_client.parser import text_string_to_metric_families
from websockets.datastructures import Headers
from websockets.http11 import Request

from server.monitoring import monitor as monitor_module
from server.monitoring.health import Health, Sources
from server.monitoring.metrics import Metrics
from server.monitoring.monitor import WATCHDOG_NOTIFICATIONS, EventLoopMonitor, Monitor
from server.monitoring.systemd import SystemdNotifier
from tests.helpers.arm_server import ArmClient, ServerOnBus, values_of
from tests.helpers.metric_samples import samples
from tests.helpers.server import RunningServer
from tests.helpers.stepped_loop import SteppedLoop

TIMEOUT_S = 30.0

# On a busy machine [s].
LOADING_S = 60.0


def ask(port: int, path: str) -> tuple[int, bytes]:
    """Status and body of what is answered over HTTP."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=TIMEOUT_S) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as refused:
        return refused.code, refused.read()


def health(port: int, path: str = "/healthz") -> tuple[int, dict[str, Any]]:
    status, body = ask(port, path)
    return status, json.loads(body)


def metrics(port: int) -> dict[str, float]:
    """The samples of a server, by name and values of labels."""
    text = ask(port, "/metrics")[1].decode()
    return {
        "/".join((each.name, *each.labels.values())): each.value
        for family in text_string_to_metric_families(text)
        for each in family.samples
    }


async def test_routes_are_answered_before_any_part_is_there() -> None:
    monitor = Monitor(SystemdNotifier())
    assert set(monitor.routes) == {"healthz", "readyz", "livez", "metrics"}
    assert monitor.health().reasons == ("the server is starting",)
    monitor.notify_started()
    assert monitor.health().ready
    monitor.notify_stopping()
    assert monitor.health().reasons == ("the server is stopping",)


async def test_a_fault_makes_the_server_unready_but_not_dead(served: ServerOnBus, client: ArmClient) -> None:
    port = served.server.port
    async with asyncio.timeout(TIMEOUT_S):
        # Planners load behind the start.
        while (told := await asyncio.to_thread(health, port))[1]["reasons"] == ["the planners are loading"]:
            await asyncio.sleep(0.1)
    assert told == (200, {"live": True, "ready": True, "reasons": [], "warnings": []})
    await client.call("/arm/emergency_stop")
    await client.until("/arm/state", lambda states: "fault" in values_of(states[-1]))
    status, faulty = await asyncio.to_thread(health, port)
    assert (status, faulty["reasons"]) == (503, ["the arm has a fault: emergency_stop"])
    assert (await asyncio.to_thread(ask, port, "/readyz"))[0] == 503
    assert (await asyncio.to_thread(ask, port, "/livez"))[0] == 200
    assert (await asyncio.to_thread(metrics, port))["armbridge_arm_fault/emergency_stop"] == 1


async def test_metrics_follow_what_happens(served: ServerOnBus, client: ArmClient) -> None:
    port = served.server.port
    before = await asyncio.to_thread(metrics, port)
    await client.goal("/moveit_goal_named", "std_msgs/String", {"data": "nowhere"})
    await client.goal("/moveit_goal_named", "std_msgs/String", {"data": "home"})
    await client.until("/moveit_goal_result", lambda answers: len(answers) == 2)
    after = await asyncio.to_thread(metrics, port)
    grown = {name: value - before.get(name, 0.0) for name, value in after.items()}
    assert grown["armbridge_goals_total/SUCCESS//moveit_goal_named"] == 1
    assert sum(value for name, value in grown.items() if name.startswith("armbridge_goals_total")) == 2
    assert grown["armbridge_received_messages_total"] >= 4
    assert grown["armbridge_sent_messages_total"] > 10
    assert after["armbridge_bus_replies_total"] > 100
    assert after["armbridge_clients"] >= 1
    assert after["armbridge_servo_temperature_celsius/gripper"] > 0
    assert {f"armbridge_process_threads/{name}" for name in ("server", "arm", "planner_1", "planner_2")} <= set(after)


async def test_levels_of_the_log_are_changed_while_the_server_runs(served: ServerOnBus, client: ArmClient) -> None:
    for level in (logging.DEBUG, 0):
        levels = [{"name": "armbridge.operations_test", "level": level}]
        done = await client.call("/armbridge/set_logger_levels", levels=levels)
        assert done["results"] == [{"successful": True, "reason": ""}]
    assert served.server.has_logged("the level of armbridge.operations_test is debug now")


class Systemd:
    """A service notifier, which keeps all that it hears."""

    def __init__(self, path: Path) -> None:
        self.heard: list[str] = []
        self.address = str(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(self.address)
        self._reader = threading.Thread(target=self._listen)
        self._reader.start()

    def has_heard(self, words: str, times: int = 1) -> bool:
        until_s = time.monotonic() + TIMEOUT_S
        while self.heard.count(words) < times and time.monotonic() < until_s:
            time.sleep(0.02)
        return self.heard.count(words) >= times

    def close(self) -> None:
        self._socket.shutdown(socket.SHUT_RD)
        self._reader.join(TIMEOUT_S)
        self._socket.close()

    def _listen(self) -> None:
        while datagram := self._socket.recv(4096):
            self.heard += datagram.decode().splitlines()


@pytest.fixture(scope="module")
def systemd(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Systemd]:
    listening = Systemd(tmp_path_factory.mktemp("systemd") / "notify")
    yield listening
    listening.close()


@pytest.fixture(scope="module")
def service(systemd: Systemd) -> Iterator[RunningServer]:
    """A server as systemd starts it, with JSON for journald's readers."""
    settings = {
        "NOTIFY_SOCKET": systemd.address,
        "WATCHDOG_USEC": "300000",
        "ARMBRIDGE_SERVER__LOG_FORMAT": "json",
    }
    with RunningServer(settings=settings) as running:
        yield running


@pytest.mark.real_time
def test_systemd_hears_that_the_server_is_ready_and_again_and_again_that_it_lives(
    service: RunningServer, systemd: Systemd
) -> None:
    assert systemd.has_heard("READY=1")
    assert systemd.has_heard("WATCHDOG=1", times=systemd.heard.count("WATCHDOG=1") + 3)
    assert any(words.startswith("STATUS=the server is starting") for words in systemd.heard)


def children_of(service: RunningServer) -> list[int]:
    pid = service.process.pid
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.mark.real_time
def test_children_do_not_speak_for_the_server(service: RunningServer) -> None:
    assert len(children_of(service)) >= 3
    for child in children_of(service):
        assert b"NOTIFY_SOCKET" not in Path(f"/proc/{child}/environ").read_bytes()


def until_it_ignores(pid: int, number: signal.Signals) -> None:
    """Wait until a process ignores a signal, which planners do once they have loaded their libraries."""
    until_s = time.monotonic() + LOADING_S
    while not ignored_by(pid) >> number - 1 & 1:
        assert time.monotonic() < until_s
        time.sleep(0.02)


def ignored_by(pid: int) -> int:
    """The signals that a process ignores, the first in the lowest bit (SigIgn in proc_pid_status(5))."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("SigIgn:")).split()[1], 16)


@pytest.mark.real_time
def test_a_signal_to_all_processes_changes_the_level_and_ends_none(service: RunningServer) -> None:
    children = children_of(service)
    for child in children:
        until_it_ignores(child, signal.SIGUSR1)
    for words in ("is debug now", "again what the settings say"):
        for pid in (service.process.pid, *children):
            os.kill(pid, signal.SIGUSR1)
        assert service.has_logged(words)
    assert children_of(service) == children


@pytest.mark.real_time
def test_every_line_of_the_log_is_json_also_those_of_children(service: RunningServer) -> None:
    lines = [json.loads(line) for line in list(service.lines)]
    assert {line["process"] for line in lines} >= {"server", "robot.control.loop"}
    assert {"time", "level", "logger", "message", "process", "pid"} <= set.intersection(*(set(line) for line in lines))


@pytest.mark.real_time
def test_systemd_hears_that_the_server_ends(service: RunningServer, systemd: Systemd) -> None:
    assert service.end(signal.SIGTERM)[0] == 0
    assert systemd.has_heard("STOPPING=1")


# The event loop.

WELL = Health(live=True, ready=True)
DEAD = Health(live=False, ready=False, reasons=("the arm process has been silent", "and so on"))


def lag() -> Histogram:
    return Metrics(Sources()).loop_lag_s


class Listening(SystemdNotifier):
    """A notifier that keeps its notifications."""

    def __init__(self, watchdog_s: float = 3.0) -> None:
        super().__init__()
        self.watchdog_s = watchdog_s
        self.heard: list[str] = []

    def notify_watchdog(self) -> None:
        self.heard.append("alive")

    def notify_status(self, status: str) -> None:
        self.heard.append(status)


def test_a_sign_of_life_comes_well_before_it_is_missed() -> None:
    notifier = Listening(watchdog_s=3.0)
    monitored = EventLoopMonitor(notifier, lambda: WELL, lag())
    for tick in range(13):
        monitored.check(100.0 + 0.25 * tick)
    assert notifier.heard == ["ready", *["alive"] * (1 + int(WATCHDOG_NOTIFICATIONS))]


def test_a_server_that_is_not_live_gives_no_sign_of_life() -> None:
    notifier = Listening()
    monitored = EventLoopMonitor(notifier, lambda: DEAD, lag())
    for now_s in range(100, 130):
        monitored.check(float(now_s))
    assert notifier.heard == ["the arm process has been silent; and so on"]


def test_no_sign_of_life_is_given_where_nobody_waits_for_it() -> None:
    notifier = Listening(watchdog_s=0.0)
    monitored = EventLoopMonitor(notifier, lambda: WELL, lag())
    monitored.check(100.0)
    assert notifier.heard == ["ready"]


def test_the_status_is_told_when_it_changes() -> None:
    notifier, found = Listening(watchdog_s=0.0), [WELL, WELL, DEAD, DEAD, WELL]
    monitored = EventLoopMonitor(notifier, lambda: found.pop(0), lag())
    for now_s in range(5):
        monitored.check(float(now_s))
    assert notifier.heard == ["ready", "the arm process has been silent; and so on", "ready"]


@pytest.mark.stepped_time
async def test_what_holds_the_loop_up_shows_as_its_lag(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, SteppedLoop)
    monkeypatch.setattr(monitor_module, "time", SimpleNamespace(monotonic=loop.time))
    lag_s = lag()
    watching = asyncio.create_task(EventLoopMonitor(Listening(), lambda: WELL, lag_s, period_s=0.01).run())
    await asyncio.sleep(0.055)
    name = "armbridge_event_loop_lag_seconds"
    assert samples(lag_s.collect())[f"{name}_sum",] == pytest.approx(0.0)
    loop.advance(0.1)
    await asyncio.sleep(0.02)
    watching.cancel()
    # The look that was due 5 ms later came when the loop was free again.
    assert samples(lag_s.collect())[f"{name}_sum",] == pytest.approx(0.095)
    assert samples(lag_s.collect())[f"{name}_count",] == 7


# Metrics over HTTP.


async def test_who_scrapes_gets_the_metrics_in_the_format_that_is_wanted() -> None:
    answer = Monitor(SystemdNotifier()).routes["metrics"]
    plain = await answer(Request("/metrics", Headers()))
    assert plain.headers["Content-Type"].startswith("text/plain; version=")
    assert any(family.name == "armbridge_live" for family in text_string_to_metric_families(plain.body.decode()))
    accepting = Headers({"Accept": "application/openmetrics-text; version=1.0.0"})
    modern = await answer(Request("/metrics", accepting))
    assert modern.headers["Content-Type"].startswith("application/openmetrics-text")
    assert modern.body.endswith(b"# EOF\n")
