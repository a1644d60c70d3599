"""Waits of a serial port, in real time; tests/robot has all else about it."""

import os
import pty
import time
import tty

import pytest

from robot.hardware.port import open_port

BAUDRATE = 1_000_000


@pytest.mark.parametrize("kind", ["pseudo terminal", "loop://"])
def test_a_silent_line_is_waited_for_no_longer_than_asked(kind: str) -> None:
    """On a line with a file descriptor and on one without; a busy machine makes any of the waits longer."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    port = open_port(kind if kind == "loop://" else os.ttyname(slave), BAUDRATE)
    waits_s = []
    for _ in range(5):
        began_s = time.monotonic()
        assert port.receive(0.02) == b""
        waits_s.append(time.monotonic() - began_s)
    assert 0.02 <= min(waits_s) < 0.2
    port.closePort()
    os.close(master)
    os.close(slave)
