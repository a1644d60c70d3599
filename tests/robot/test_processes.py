"""Processes and the channels between them."""

import logging
import socket
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.channel import MAX_MESSAGE_BYTES, MAX_PENDING_BYTES, Channel, Decoder, encode, send_log
from robot.processes import RestartDelay


def test_the_delay_before_a_start_follows_how_long_the_processes_ran() -> None:
    for ran_s, delays_s in (
        ([0.0] * 8, [0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 10.0, 10.0]),
        ([3600.0, 5.0, 1.0], [0.0, 0.0, 0.0]),
        ([0.9, 0.9, 0.0, 1.0, 0.0, 0.9], [0.2, 0.4, 0.8, 0.0, 0.2, 0.4]),
    ):
        delay = RestartDelay(0.2, 10.0)
        assert [delay.after(each) for each in ran_s] == delays_s


@given(st.lists(st.binary(max_size=300), max_size=8), st.integers(min_value=1, max_value=50))
def test_messages_survive_any_cutting_of_the_stream_up_to_the_limit(messages: list[bytes], size: int) -> None:
    stream = b"".join(encode(message) for message in messages)
    decoder = Decoder()
    got = [m for start in range(0, len(stream), size) for m in decoder.feed(stream[start : start + size])]
    assert got == messages
    for refused in (lambda: Decoder().feed(b"\xff\xff\xff\xff"), lambda: encode(bytes(MAX_MESSAGE_BYTES))):
        with pytest.raises(ValueError, match="over the limit"):
            refused()


@pytest.fixture
def pair() -> Iterator[tuple[Channel, Channel]]:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        yield Channel(ours), Channel(theirs)


def test_a_channel_waits_no_longer_than_asked_and_notices_the_others_end(pair: tuple[Channel, Channel]) -> None:
    child, server = pair
    assert (child.receive(0.0), child.receive(0.01)) == ([], [])
    for number in range(3):
        server.send(number)
    assert child.receive_first() == 0
    assert (child.receive(0.0), child.receive(0.0)) == ([1, 2], [])
    server._socket.close()
    assert child.receive_first() is None
    assert child.closed
    child.send("nobody hears this")


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


def test_a_process_sends_the_lines_of_its_log_to_the_other_end(pair: tuple[Channel, Channel]) -> None:
    child, server = pair
    handler = send_log(child, "robot.control.loop")
    try:
        logging.getLogger("armbridge.arm").warning("the arm %s", "sinks")
    finally:
        handler.close()
    (line,) = server.receive(1.0)
    assert (line.process, line.logger, line.text) == ("robot.control.loop", "armbridge.arm", "the arm sinks")
