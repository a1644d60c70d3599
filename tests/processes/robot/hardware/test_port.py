"""Waits of a serial port, in real time; tests/robot has all else about it."""

import os
import pty
import time
import tty
from collections.abc import Callable, Iterator

import pytest

from robot.hardware.port import open_port

BAUDRATE = 1_000_000


@pytest.fixture(params=["pseudo terminal", "loop://"])
def silent_line(request: pytest.FixtureRequest) -> Iterator[str]:
    """URL of a line on which nothing comes, with a file descriptor and without."""
    if request.param == "loop://":
        yield request.param
        return
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


def shortest_s(receive: Callable[[], bytes]) -> float:
    """The shortest of several waits on a silent line: a busy machine makes any of them longer."""
    waits_s = []
    for _ in range(5):
        began_s = time.monotonic()
        assert receive() == b""
        waits_s.append(time.monotonic() - began_s)
    return min(waits_s)


def test_a_silent_line_is_waited_for_no_longer_than_asked(silent_line: str) -> None:
    port = open_port(silent_line, BAUDRATE)
    assert 0.02 <= shortest_s(lambda: port.receive(0.02)) < 0.2
    port.closePort()
