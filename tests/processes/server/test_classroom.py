"""The supervisor in a process of its own, which it needs: it forks, and lives by signals."""

import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from harness.server import ROOT
from harness.waiting import TIMEOUT_S, wait_until
from server import classroom as module
from server.classroom import Member

# Members that say when they wait for SIGTERM or ignore it.
PROGRAM = """
import logging, os, signal, sys, time
from pathlib import Path
from server.classroom import Member, supervise

logging.basicConfig(level="INFO", format="%(message)s")

def wait():
    def take(*_):
        Path({folder!r}, "ended").touch()
        raise SystemExit
    signal.signal(signal.SIGTERM, take)
    Path({folder!r}, f"ready {{os.getpid()}}").touch()
    while True:
        time.sleep(1)

def be_deaf():
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    Path({folder!r}, f"ready {{os.getpid()}}").touch()
    while True:
        time.sleep(1)

import server.classroom as module
module.END_TIMEOUT_S = {end_timeout_s}
members = [Member("one", wait, Path({folder!r}, "one.log")), Member("two", {second}, Path({folder!r}, "two.log"))]
supervise(members)
print("done")
"""


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Callable[[str], psutil.Process]]:
    started: list[subprocess.Popen[str]] = []

    def start(second: str) -> psutil.Process:
        # A member that listens is waited for, however busy the machine is.
        end_timeout_s = 0.5 if second == "be_deaf" else TIMEOUT_S
        program = PROGRAM.format(folder=str(tmp_path), second=second, end_timeout_s=end_timeout_s)
        process = subprocess.Popen([sys.executable, "-c", program], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        started.append(process)
        supervisor = psutil.Process(process.pid)
        wait_until(lambda: (tmp_path / "two.log").exists() and bool(supervisor.children()))
        return supervisor

    yield start
    for process in started:
        process.kill()
        process.communicate(timeout=TIMEOUT_S)


def until_ready(folder: Path) -> None:
    """Wait until both members have their handlers of SIGTERM, without which it ends them at once."""
    wait_until(lambda: len(list(folder.glob("ready *"))) == 2)


def test_one_signal_ends_all_in_good_order(run: Callable[[str], psutil.Process], tmp_path: Path) -> None:
    supervisor = run("wait")
    until_ready(tmp_path)
    # Members are out of reach of the terminal's Ctrl-C.
    assert all(os.getsid(child.pid) == child.pid for child in supervisor.children())
    supervisor.send_signal(signal.SIGINT)
    wait_until(lambda: not supervisor.is_running() or supervisor.status() == psutil.STATUS_ZOMBIE)
    assert (tmp_path / "ended").exists()


@pytest.mark.parametrize(("second", "number"), [("be_deaf", signal.SIGTERM), ("wait", signal.SIGKILL)])
def test_members_end_though_one_does_not_listen_and_with_a_supervisor_that_is_killed(
    run: Callable[[str], psutil.Process], tmp_path: Path, second: str, number: signal.Signals
) -> None:
    supervisor = run(second)
    until_ready(tmp_path)
    children = supervisor.children()
    supervisor.send_signal(number)
    wait_until(lambda: not any(child.is_running() for child in children))
    # A deaf member costs the other its order where that is late.
    assert second == "be_deaf" or (tmp_path / "ended").exists()


def test_a_member_without_a_start_is_retried(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    tries_s: list[float] = []
    member = Member("one", lambda: None)
    now_s = 0.0

    def fail(_run: object) -> None:
        tries_s.append(now_s)
        raise OSError("no process is left")

    monkeypatch.setattr(module, "ForkedProcess", fail)
    while now_s < 60.0:
        member.reap(now_s)
        member.start_if_due(now_s)
        now_s += 0.1
    waits_s = [later - earlier for earlier, later in itertools.pairwise(tries_s)]
    assert waits_s == sorted(waits_s)
    assert max(waits_s) < 11.0
    assert member.pid is None
    assert "one cannot be started: no process is left" in caplog.text
