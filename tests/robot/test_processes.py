from __future__ import annotations

import asyncio
import os
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot import processes
from robot.processes import MAX_MESSAGE_BYTES, MAX_PENDING_BYTES, Channel, Child, Decoder, encode

ECHO = "tests.helpers.echo_child"


@given(st.lists(st.binary(max_size=300), max_size=8), st.integers(min_value=1, max_value=50))
def test_messages_survive_any_cutting_of_the_stream(messages: list[bytes], size: int) -> None:
    stream = b"".join(encode(message) for message in messages)
    decoder = Decoder()
    got = [m for start in range(0, len(stream), size) for m in decoder.feed(stream[start : start + size])]
    assert got == messages


def test_a_message_over_the_limit_is_refused() -> None:
    with pytest.raises(ValueError, match="over the limit"):
        Decoder().feed(b"\xff\xff\xff\xff")


def test_a_message_that_the_other_end_refuses_is_not_sent() -> None:
    with pytest.raises(ValueError, match="over the limit"):
        encode(bytes(MAX_MESSAGE_BYTES))


@pytest.fixture
def pair() -> Iterator[tuple[Channel, Channel]]:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        yield Channel(ours), Channel(theirs)


def test_a_channel_waits_no_longer_than_told(pair: tuple[Channel, Channel]) -> None:
    assert pair[0].receive(0.0) == []
    assert pair[0].receive(0.01) == []


def test_a_channel_notices_that_the_other_end_is_gone() -> None:
    ours, theirs = socket.socketpair()
    channel = Channel(ours)
    theirs.close()
    assert channel.receive_first() is None
    assert channel.closed
    channel.send("nobody hears this")
    ours.close()


def test_what_comes_right_behind_the_first_message_is_not_lost(pair: tuple[Channel, Channel]) -> None:
    child, server = pair
    for number in range(3):
        server.send(number)
    assert child.receive_first() == 0
    assert child.receive(0.0) == [1, 2]
    assert child.receive(0.0) == []


def test_to_a_server_that_does_not_read_only_what_may_not_be_dropped_is_kept(pair: tuple[Channel, Channel]) -> None:
    child, server = pair
    for number in range(5000):
        child.send(("state", number, b"x" * 1000), droppable=True)
    child.send("result")
    received: list[Any] = []
    while "result" not in received:
        received += server.receive(0.1)
        child.receive(0.0)
    assert len(received) < 5000
    assert sum(len(encode(message)) for message in received) < MAX_PENDING_BYTES + (2 << 20)
    numbers = [message[1] for message in received[:-1]]
    assert numbers == sorted(numbers)


async def start_echo(received: list[Any], exited: asyncio.Event) -> Child:
    child = Child(ECHO, received.append, exited.set)
    await child.connect()
    return child


@pytest.fixture(autouse=True)
def children_find_the_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))


async def until(received: list[Any], count: int) -> None:
    async with asyncio.timeout(10.0):
        while len(received) < count:
            await asyncio.sleep(0.005)


async def test_a_child_answers_in_order_whatever_the_size() -> None:
    received: list[Any] = []
    child = await start_echo(received, asyncio.Event())
    sent = [1, "two", b"3" * 1_000_000, {"four": [5.0]}]
    for message in sent:
        child.send(message)
    await until(received, len(sent))
    assert received == sent
    await child.kill()


async def test_the_end_of_a_child_is_told_once() -> None:
    exited = asyncio.Event()
    child = await start_echo([], exited)
    os.kill(child.pid, signal.SIGKILL)
    await asyncio.wait_for(exited.wait(), 5.0)
    await child.wait(1.0)
    assert not child.running
    child.send("nobody hears this")


async def test_a_child_ends_when_its_server_does() -> None:
    exited = asyncio.Event()
    child = await start_echo([], exited)
    child.send("close")
    await asyncio.wait_for(exited.wait(), 5.0)
    await child.wait(1.0)


async def test_a_child_that_does_not_end_is_ended_by_force() -> None:
    received: list[Any] = []
    child = await start_echo(received, asyncio.Event())
    child.send("ready?")
    await until(received, 1)
    await asyncio.wait_for(child.wait(0.1), 5.0)
    assert not child.running


@pytest.mark.parametrize("garbage", [b"\xff\xff\xff\xff", b"\x04\x00\x00\x00what"], ids=["huge", "no pickle"])
async def test_a_child_that_sends_garbage_is_ended_and_its_end_told(garbage: bytes) -> None:
    exited = asyncio.Event()
    child = Child(ECHO, lambda _message: None, exited.set)
    await child.connect()
    child.send(("raw", garbage))
    await asyncio.wait_for(exited.wait(), 5.0)
    await child.wait(5.0)
    assert child.ending == "SIGKILL"


async def test_how_a_child_ended_is_told() -> None:
    exited = asyncio.Event()
    child = await start_echo([], exited)
    assert child.ending == "it still runs"
    child.send("close")
    await child.wait(5.0)
    assert child.ending == "exit code 0"


async def test_an_error_in_serving_one_message_does_not_make_the_server_deaf(
    caplog: pytest.LogCaptureFixture,
) -> None:
    received: list[Any] = []

    def serve(message: Any) -> None:
        if message == "bad":
            raise ValueError(message)
        received.append(message)

    child = Child(ECHO, serve, lambda: None)
    await child.connect()
    for message in ("good", "bad", "good again"):
        child.send(message)
    await until(received, 2)
    assert received == ["good", "good again"]
    assert "serving a message" in caplog.text
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
