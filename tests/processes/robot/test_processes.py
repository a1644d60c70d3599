import asyncio
import json
import logging
import os
import signal
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from harness.waiting import TIMEOUT_S, until
from robot import logs, processes
from robot.logs import LoggerLevel
from robot.processes import Child, DescriptorReserve, StartedChild
from tests.helpers.programs import run_python
from tests.helpers.resources import no_descriptors_left

ECHO = "tests.helpers.echo_child"


class Echo:
    """A child that answers what it is sent, and what it has said; its server fails to serve the refused message."""

    def __init__(self, refused: str = "") -> None:
        self.received: list[Any] = []
        self.exited = asyncio.Event()
        self._refused = refused
        self.child = Child(StartedChild(ECHO), self._take, self.exited.set)

    def _take(self, message: Any) -> None:
        if message == self._refused:
            raise ValueError(message)
        self.received.append(message)

    async def exchange(self, *messages: Any, answers: int | None = None) -> list[Any]:
        """Send messages, and return the answers to all so far, or to some, when they are there."""
        expected = len(self.received) + len(messages) if answers is None else answers
        for message in messages:
            self.child.send(message)
        await until(lambda: len(self.received) >= expected)
        return self.received

    async def end(self) -> None:
        """Wait for its end."""
        await asyncio.wait_for(self.exited.wait(), TIMEOUT_S)
        await self.child.wait(TIMEOUT_S)


Start = Callable[..., Awaitable[Echo]]


@pytest.fixture
async def start() -> AsyncIterator[Start]:
    """Starts children, and kills them at the end."""
    started: list[Echo] = []

    async def echo(refused: str = "") -> Echo:
        started.append(Echo(refused))
        await started[-1].child.connect()
        return started[-1]

    yield echo
    for each in started:
        await each.child.kill()


@pytest.fixture
async def echo(start: Start) -> Echo:
    return await start()


@pytest.fixture(autouse=True)
def children_find_the_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))


async def test_a_child_answers_in_order_whatever_the_size(echo: Echo) -> None:
    sent = [1, "two", b"3" * 1_000_000, {"four": [5.0]}]
    assert await echo.exchange(*sent) == sent


@pytest.mark.parametrize("begun", [False, True], ids=["running", "only begun"])
async def test_a_signal_that_is_for_the_server_does_not_end_a_child(start: Start, begun: bool) -> None:
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGUSR1):
        echo = await start()
        if not begun:
            await echo.exchange("ready?")
        os.kill(echo.child.pid, number)
        assert (await echo.exchange("there?"))[-1] == "there?"


def test_the_start_of_a_child_keeps_no_signal_from_the_server() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    StartedChild(ECHO).close()
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


async def test_the_last_messages_of_a_child_that_has_ended_are_delivered(echo: Echo) -> None:
    await echo.exchange("ready?")
    for message in ("last", "last", "last", "close"):
        echo.child.send(message)
    # The event loop stands still meanwhile: nothing of what the child sends has been read when it has ended.
    while echo.child.running:
        time.sleep(0.001)  # noqa: ASYNC251 - see above
    await echo.child.wait(TIMEOUT_S)
    assert echo.received == ["ready?", "last", "last", "last"]
    assert echo.exited.is_set()


@pytest.mark.parametrize(
    ("message", "ending"),
    [
        ("close", "exit code 0"),
        (("raw", b"\xff\xff\xff\xff"), "SIGKILL"),
        (("raw", b"\x04\x00\x00\x00what"), "SIGKILL"),
    ],
    ids=["asked to", "for a huge message", "for a message that is no pickle"],
)
async def test_the_end_of_a_child_is_reported_and_how_it_ended(echo: Echo, message: Any, ending: str) -> None:
    assert echo.child.ending == "it still runs"
    echo.child.send(message)
    await echo.end()
    assert (echo.child.running, echo.child.ending) == (False, ending)
    echo.child.send("nobody hears this")


async def test_a_child_that_does_not_end_is_killed_and_logged(echo: Echo, caplog: pytest.LogCaptureFixture) -> None:
    await echo.exchange("ready?")
    await asyncio.wait_for(echo.child.wait(0.1), TIMEOUT_S)
    assert not echo.child.running
    assert f"process {echo.child.pid} has not ended within 0.1 s and is killed" in caplog.text


async def test_an_error_with_one_message_costs_no_later_one(start: Start, caplog: pytest.LogCaptureFixture) -> None:
    echo = await start(refused="bad")
    assert await echo.exchange("good", "bad", "good again", answers=2) == ["good", "good again"]
    assert "serving a message" in caplog.text


async def test_a_level_is_changed_in_children_that_run_and_in_those_that_follow(
    start: Start, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(logs, "_changed", {})
    first = await start()
    assert logs.change(LoggerLevel("armbridge.echo", logging.DEBUG))
    for echo in (first, await start()):
        await echo.exchange(("log", "armbridge.echo", logging.DEBUG, "said"), "done", answers=1)
    assert capfd.readouterr().err.count("DEBUG   armbridge.echo: said") == 2
    assert logging.getLogger("armbridge.echo").level == logging.DEBUG


async def test_a_child_logs_as_its_server_does(
    start: Start, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(logs, "format_in_use", lambda: "json")
    echo = await start()
    await echo.exchange(("log", "armbridge.echo_json", logging.ERROR, "said"), "done", answers=1)
    (line,) = [json.loads(line) for line in capfd.readouterr().err.splitlines()]
    assert (line["process"], line["pid"], line["message"]) == (ECHO, echo.child.pid, "said")


def test_no_namesake_is_imported_from_the_working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "__init__.py").write_text("raise SystemExit(7)")
    monkeypatch.chdir(tmp_path)
    assert processes.start_module("server.cli", ["--help"], ()).wait(TIMEOUT_S) == 0


def test_the_reserve_is_filled_again_as_far_as_it_goes() -> None:
    reserve = DescriptorReserve(4)
    reserve.fill()
    with no_descriptors_left():
        with reserve.lent():
            taken = os.open(os.devnull, os.O_RDONLY)
        assert len(reserve._held) == 3
        os.close(taken)
        reserve.fill()
        assert len(reserve._held) == 4
    reserve.close()


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
from harness.waiting import TIMEOUT_S
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
    await asyncio.wait_for(exited.wait(), TIMEOUT_S)
    await child.wait(TIMEOUT_S)
    print(json.dumps([received[0], child.pid, running, child.ending]))

asyncio.run(main(StartedChild("", body=echo)))
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
    done = run_python(FORKED.replace("{end}", end))
    (message, pid, session), seen_pid, running, ended = json.loads(done.stdout)
    assert (message, running, ended) == ("hello", True, ending)
    # Out of reach of the terminal's Ctrl-C.
    assert pid == seen_pid == session


def test_a_forked_child_that_nobody_adopts_is_killed() -> None:
    program = """
import time
from robot.processes import StartedChild
started = StartedChild("", body=lambda sock: time.sleep(60))
started.close()
print(started.process.poll())
"""
    assert run_python(program).stdout == "-9\n"
