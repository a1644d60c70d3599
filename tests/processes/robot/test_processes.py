from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from robot import logs, processes
from robot.logs import LoggerLevel
from robot.processes import Child, DescriptorReserve, StartedChild
from tests.helpers.resources import no_descriptors_left
from tests.helpers.waiting import TIMEOUT_S, until

ECHO = "tests.helpers.echo_child"


async def start_echo(received: list[Any], exited: asyncio.Event) -> Child:
    child = Child(StartedChild(ECHO), received.append, exited.set)
    await child.connect()
    return child


@pytest.fixture(autouse=True)
def children_find_the_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))


async def test_a_child_answers_in_order_whatever_the_size() -> None:
    received: list[Any] = []
    child = await start_echo(received, asyncio.Event())
    sent = [1, "two", b"3" * 1_000_000, {"four": [5.0]}]
    for message in sent:
        child.send(message)
    await until(lambda: len(received) >= len(sent))
    assert received == sent
    await child.kill()


@pytest.mark.parametrize("begun", [False, True], ids=["running", "only begun"])
async def test_a_signal_that_is_for_the_server_does_not_end_a_child(begun: bool) -> None:
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGUSR1):
        received: list[Any] = []
        child = await start_echo(received, asyncio.Event())
        if not begun:
            child.send("ready?")
            await until(lambda received=received: received == ["ready?"])
        os.kill(child.pid, number)
        child.send("there?")
        await until(lambda received=received: received[-1:] == ["there?"])
        await child.kill()


def test_the_start_of_a_child_keeps_no_signal_from_the_server() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    StartedChild(ECHO).close()
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


async def test_the_end_of_a_child_is_reported_once() -> None:
    exited = asyncio.Event()
    child = await start_echo([], exited)
    os.kill(child.pid, signal.SIGKILL)
    await asyncio.wait_for(exited.wait(), TIMEOUT_S)
    await child.wait(TIMEOUT_S)
    assert not child.running
    child.send("nobody hears this")


async def test_the_last_messages_of_a_child_that_has_ended_are_delivered() -> None:
    received: list[Any] = []
    exited = asyncio.Event()
    child = await start_echo(received, exited)
    child.send("ready?")
    await until(lambda: len(received) >= 1)
    for _ in range(3):
        child.send("last")
    child.send("close")
    # The event loop stands still meanwhile: nothing of what the child sends has been read when it has ended.
    while child.running:
        time.sleep(0.001)  # noqa: ASYNC251 - see above
    await child.wait(TIMEOUT_S)
    assert received == ["ready?", "last", "last", "last"]
    assert exited.is_set()


async def test_a_child_ends_when_its_server_does_and_how_is_reported() -> None:
    exited = asyncio.Event()
    child = await start_echo([], exited)
    assert child.ending == "it still runs"
    child.send("close")
    await asyncio.wait_for(exited.wait(), TIMEOUT_S)
    await child.wait(TIMEOUT_S)
    assert child.ending == "exit code 0"


async def test_a_child_that_does_not_end_is_ended_by_force_and_told_of(caplog: pytest.LogCaptureFixture) -> None:
    received: list[Any] = []
    child = await start_echo(received, asyncio.Event())
    child.send("ready?")
    await until(lambda: len(received) >= 1)
    await asyncio.wait_for(child.wait(0.1), TIMEOUT_S)
    assert not child.running
    assert f"process {child.pid} has not ended within 0.1 s and is killed" in caplog.text


@pytest.mark.parametrize("garbage", [b"\xff\xff\xff\xff", b"\x04\x00\x00\x00what"], ids=["huge", "no pickle"])
async def test_a_child_that_sends_garbage_is_ended_and_its_end_reported(garbage: bytes) -> None:
    exited = asyncio.Event()
    child = Child(StartedChild(ECHO), lambda _message: None, exited.set)
    await child.connect()
    child.send(("raw", garbage))
    await asyncio.wait_for(exited.wait(), TIMEOUT_S)
    await child.wait(TIMEOUT_S)
    assert child.ending == "SIGKILL"


async def test_an_error_in_serving_one_message_does_not_make_the_server_deaf(
    caplog: pytest.LogCaptureFixture,
) -> None:
    received: list[Any] = []

    def serve(message: Any) -> None:
        if message == "bad":
            raise ValueError(message)
        received.append(message)

    child = Child(StartedChild(ECHO), serve, lambda: None)
    await child.connect()
    for message in ("good", "bad", "good again"):
        child.send(message)
    await until(lambda: len(received) >= 2)
    assert received == ["good", "good again"]
    assert "serving a message" in caplog.text
    await child.kill()


@pytest.fixture
def no_changed_levels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "_changed", {})


async def test_a_level_is_changed_in_children_that_run_and_in_those_that_follow(
    no_changed_levels: None, capfd: pytest.CaptureFixture[str]
) -> None:
    received: list[Any] = []
    first = await start_echo(received, asyncio.Event())
    assert logs.change(LoggerLevel("armbridge.echo", logging.DEBUG))
    second = await start_echo(received, asyncio.Event())
    for child in (first, second):
        child.send(("log", "armbridge.echo", logging.DEBUG, "said"))
        child.send("done")
    await until(lambda: len(received) >= 2)
    assert capfd.readouterr().err.count("DEBUG   armbridge.echo: said") == 2
    assert logging.getLogger("armbridge.echo").level == logging.DEBUG
    await first.kill()
    await second.kill()


async def test_a_child_logs_as_its_server_does(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(logs, "format_in_use", lambda: "json")
    received: list[Any] = []
    child = await start_echo(received, asyncio.Event())
    child.send(("log", "armbridge.echo_json", logging.ERROR, "said"))
    child.send("done")
    await until(lambda: len(received) >= 1)
    (line,) = [json.loads(line) for line in capfd.readouterr().err.splitlines()]
    assert (line["process"], line["pid"], line["message"]) == (ECHO, child.pid, "said")
    await child.kill()


def test_a_folder_of_the_same_name_in_the_working_directory_is_not_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "__init__.py").write_text("raise SystemExit(7)")
    monkeypatch.chdir(tmp_path)
    process = processes.start_module("robot.emulator", ["--help"], ())
    assert process.wait(20.0) == 0
    assert sys.executable


def test_with_descriptors_in_reserve_a_child_is_started_when_all_others_are_used_up() -> None:
    reserve = DescriptorReserve()
    reserve.fill()
    with no_descriptors_left():
        with pytest.raises(OSError, match="Too many open files"):
            StartedChild(ECHO)
        with reserve.lent():
            started = StartedChild(ECHO)
    started.close()
    reserve.close()


def test_the_reserve_is_filled_again_as_far_as_it_goes() -> None:
    reserve = DescriptorReserve(4)
    reserve.fill()
    with no_descriptors_left():
        with reserve.lent():
            taken = os.open(os.devnull, os.O_RDONLY)
        assert reserve.held == 3
        os.close(taken)
        reserve.fill()
        assert reserve.held == 4
    reserve.close()
    assert reserve.held == 0


def test_a_start_that_fails_leaves_no_descriptor_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    before = sorted(Path("/proc/self/fd").iterdir())
    with pytest.raises(FileNotFoundError) as failure:
        StartedChild(ECHO)
    # With its frames, and what they refer to.
    assert failure.tb
    assert sorted(Path("/proc/self/fd").iterdir()) == before


FORKED = """
import asyncio, json, os, signal, subprocess
from robot.channel import Channel
from robot.processes import Child, StartedChild

def echo(sock):
    channel = Channel(sock)
    while not channel.closed:
        for message in channel.receive(None):
            if message == "raise":
                raise ValueError("as told")
            channel.send((message, os.getpid(), os.getsid(0)))

async def main(started):
    received, exited = [], asyncio.Event()
    child = Child(started, received.append, exited.set)
    await child.connect()
    child.send("hello")
    while not received:
        await asyncio.sleep(0.01)
    running = child.running
    {end}
    await asyncio.wait_for(exited.wait(), 20)
    await child.wait(20)
    print(json.dumps([received[0], child.pid, running, child.ending]))

asyncio.run(main(StartedChild.forked(echo)))
"""


@pytest.mark.parametrize(
    ("end", "ending"),
    [
        ("await child.kill()", "SIGKILL"),
        ("child.send('raise')", "exit code 1"),
        ("child._transport.close()", "exit code 0"),
    ],
)
def test_a_forked_child_is_one_like_any_other(end: str, ending: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", FORKED.replace("{end}", end)], capture_output=True, text=True, timeout=60, check=True
    )
    (message, pid, session), seen_pid, running, ended = json.loads(done.stdout)
    assert (message, running, ended) == ("hello", True, ending)
    # Out of reach of the terminal's Ctrl-C.
    assert pid == seen_pid == session


def test_a_forked_child_that_nobody_adopts_is_killed() -> None:
    program = """
import time
from robot.processes import StartedChild
started = StartedChild.forked(lambda sock: time.sleep(60))
started.close()
print(started.process.poll())
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "-9\n"
