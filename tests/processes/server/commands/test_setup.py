"""armbridge setup on a real port, interrupted, gone on with and taken back."""

from __future__ import annotations

import contextlib
import os
import re
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robot.commissioning.scan import scan
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import Register
from server.commands.terminal import ExitCode
from tests.helpers.kit import KIT
from tests.helpers.robots import SO101_SERVOS
from tests.robot.conftest import RunningEmulator

JOINTS = [servo.joint for servo in SO101_SERVOS]


def backups(tmp_path):
    return sorted((tmp_path / "armbridge").glob("registers_*.json"))


ANSWER_TIMEOUT_S = 60.0


# A servo is asked for once, but for a machine that is starved.
MAX_ASKED = 20


class Visit:
    """The command as a process on a pseudo terminal's servos, and a person at it."""

    def __init__(self, port: str, *options: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "server.cli", "setup", "--serial", port, *options],
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            # Shells start what runs in the background with Ctrl-C ignored, and children inherit that.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )
        self.said = self._unread = ""

    def await_text(self, text: str) -> None:
        """Wait until this is said, after what was waited for before."""
        self.await_match(re.escape(text))

    def await_match(self, pattern: str) -> re.Match[str]:
        """Wait until something of this pattern is said, after what was waited for before."""
        assert self._process.stderr is not None
        while not (found := re.search(pattern, self._unread)):
            ready = select.select([self._process.stderr], [], [], ANSWER_TIMEOUT_S)[0]
            data = os.read(self._process.stderr.fileno(), 4096).decode() if ready else ""
            assert data, f"{pattern!r} was not said: {self._unread}"
            self.said += data
            self._unread += data
        self._unread = self._unread[found.end() :]
        return found

    def type(self, text: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(text.encode())
        self._process.stdin.flush()

    def interrupt(self) -> None:
        self._process.send_signal(signal.SIGINT)

    def leave(self) -> None:
        """End the process, whatever it does."""
        if self._process.returncode is None:
            self._process.kill()
            self._process.communicate(timeout=ANSWER_TIMEOUT_S)

    def end(self) -> int:
        """Wait for the end of the command; return its exit code."""
        _, rest = self._process.communicate(timeout=ANSWER_TIMEOUT_S)
        self.said += rest.decode()
        return self._process.returncode


class Table:
    """Servos of a kit at a pseudo terminal, of which some are plugged in."""

    def __init__(self, emulator: RunningEmulator, link: Path) -> None:
        self.emulator = emulator
        self.port = str(link)
        self.plug()

    def plug(self, *joints: str) -> None:
        """Have these servos on the wire, and no others."""
        self.emulator.command(unplug=[joint for joint in JOINTS if joint not in joints], plug=list(joints))


@pytest.fixture
def visit() -> Iterator[Callable[..., Visit]]:
    """Starts visits, and ends those that a failed test leaves."""
    with contextlib.ExitStack() as begun:

        def begin(*options: str) -> Visit:
            one = Visit(*options)
            begun.callback(one.leave)
            return one

        yield begin


@pytest.fixture
def on_table(start_terminal, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    link = tmp_path / "port"
    return Table(start_terminal(*KIT, "--link", str(link)), link)


def test_a_setup_on_a_real_port_is_interrupted_gone_on_with_and_taken_back(on_table, visit, tmp_path):
    first = visit(on_table.port, "--profile", "lerobot")
    first.await_text("Plug in the servo of gripper")
    on_table.plug("wrist_roll", "gripper")
    first.type("\n")
    first.await_text("several servos with the id 1 answer at once")
    on_table.plug("gripper")
    first.type("\n")
    first.await_text("[y/N]")
    first.type("y\n")
    first.await_text("Plug in the servo of wrist_roll")
    first.interrupt()
    assert first.end() == ExitCode.FAILED
    assert "run the command again" in first.said

    second = visit(on_table.port, "--yes", "--profile", "lerobot")
    # Asked for a servo once more when a starved emulator did not answer in time.
    for _ in range(MAX_ASKED):
        asked = second.await_match(r"Plug in the servo of (\w+), then press Enter|registers from before")
        if asked[1] is None:
            break
        # What is done stays connected behind the next one.
        on_table.plug(*JOINTS[JOINTS.index(asked[1]) :])
        second.type("\n")
    assert second.end() == ExitCode.DONE
    with contextlib.closing(Bus.open(on_table.port)) as bus:
        assert [servo.servo_id for servo in scan(bus, range(1, 7)).servos] == [1, 2, 3, 4, 5, 6]
        assert [bus.read(servo_id, Register.P_GAIN) for servo_id in range(1, 7)] == [16] * 6

    third = visit(on_table.port, "--restore", str(backups(tmp_path)[0]))
    third.await_text("which of its servos they are: 1, 2, 3, 4, 5\n")
    third.await_text("[y/N]")
    third.type("y\n")
    assert third.end() == ExitCode.PROBLEMS
    with contextlib.closing(Bus.open(on_table.port)) as bus:
        assert [bus.read(servo_id, Register.P_GAIN) for servo_id in range(1, 7)] == [16] * 5 + [32]


def test_an_adapter_that_was_unplugged_is_opened_anew(on_table, visit):
    one = visit(on_table.port, "--joint", "gripper", "--yes")
    one.await_text("Plug in the servo of gripper")
    on_table.emulator.command(plugged=False)
    one.type("\n")
    one.await_text("Plug in the servo of gripper")
    on_table.emulator.command(plugged="renamed")
    on_table.plug("gripper")
    one.type("\n")
    one.await_text("gripper (id 6): written and read back")
    assert one.end() == ExitCode.DONE
