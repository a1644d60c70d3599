"""Waits of a serial port, in real time; tests/robot has all else about it."""

import os
import pty
import time
import tty

from harness.waiting import wait_until
from robot.hardware.port import open_port

BAUDRATE = 1_000_000


def test_a_silent_line_is_waited_for_no_longer_than_asked() -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    port = open_port(os.ttyname(slave), BAUDRATE)

    def wait_s() -> float:
        began_s = time.monotonic()
        assert port.receive(0.02) == b""
        return time.monotonic() - began_s

    assert wait_s() >= 0.02
    # A busy machine makes any of the waits longer, but not all.
    wait_until(lambda: wait_s() < 0.2)
    port.closePort()
    os.close(master)
    os.close(slave)
