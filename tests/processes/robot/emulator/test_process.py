"""Emulated servos as a process of their own, on a pseudo terminal."""

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.waiting import TIMEOUT_S, running
from robot.errors import NoReply
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import TELEMETRY
from robot.hardware.port import TERMINAL_LATENCY_S
from tests.helpers.programs import run

IDS = (1, 2, 3, 4, 5, 6)


def opened(port: str) -> contextlib.closing[Bus]:
    """Open a bus on which every reply is waited for, however busy the machine is."""
    bus = Bus.open(port)
    bus._port.latency_s = bus._port.quiet_s = TIMEOUT_S
    return contextlib.closing(bus)


@contextlib.contextmanager
def without_replies(bus: Bus) -> Iterator[None]:
    """Wait for replies no longer than usual: none are expected."""
    bus._port.latency_s = TERMINAL_LATENCY_S
    yield
    bus._port.latency_s = TIMEOUT_S


@pytest.fixture
def line(terminal):
    with opened(terminal.port) as bus:
        yield bus


def test_live_commands_are_answered_while_the_bus_runs(terminal, line):
    assert terminal.command(drop=1.0) == {"ok": True}
    with without_replies(line):
        assert line.sync_read(IDS, TELEMETRY.address, TELEMETRY.length) == {}
    assert "unknown command" in str(terminal.command(nonsense=1)["error"])
    assert terminal.command(drop=0.0) == {"ok": True}
    assert len(line.sync_read(IDS, TELEMETRY.address, TELEMETRY.length)) == 6


def test_a_controlled_emulator_leaves_ctrl_c_to_its_controller_and_ends_after_it(terminal, line):
    terminal.process.send_signal(signal.SIGINT)
    assert line.ping(1) == 777
    terminal.let_go()
    assert terminal.process.wait(TIMEOUT_S) == 0


@contextlib.contextmanager
def standalone(*options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Emulator as a person starts it, and the port that it prints."""
    pipe = subprocess.PIPE
    command = [sys.executable, "-P", "-m", "server.cli", "emulate", *options]
    with running(command, stdin=pipe, stdout=pipe, stderr=pipe) as process:
        assert process.stdout is not None
        yield process, process.stdout.readline().strip()


def test_without_a_controller_live_commands_come_on_standard_input(tmp_path: Path) -> None:
    link = tmp_path / "arm"
    with standalone("--link", str(link)) as (process, port):
        assert str(link.readlink()) == port
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write('{"offline": [6]}\n\n{"explode": 1}\n')
        process.stdin.flush()
        assert process.stdout.readline() == '{"ok": true}\n'
        assert "explode" in process.stdout.readline()
        process.stdin.close()
        with opened(str(link)) as bus:
            assert bus.ping(5) == 777
            with without_replies(bus), pytest.raises(NoReply):
                bus.ping(6)
        process.terminate()
        assert process.wait(TIMEOUT_S) == 0
    assert not link.is_symlink()


def test_a_process_plays_a_script_from_the_first_byte_of_a_host_on_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    script, link = tmp_path / "script.jsonl", tmp_path / "arm"
    script.write_text('{"at_s": 0.1, "offline": [6]}\n')
    with standalone("--script", str(script), "--link", str(link)) as (process, port):
        # Longer than the script waits, which begins with the first byte.
        time.sleep(0.2)
        with opened(port) as bus:
            assert bus.ping(6, attempts=1) == 777
            assert process.stderr is not None
            assert process.stderr.readline() == '0.1 s: {"offline": [6]} {"ok": true}\n'
            with without_replies(bus), pytest.raises(NoReply):
                bus.ping(6)
        process.send_signal(signal.SIGINT)
        assert process.wait(TIMEOUT_S) == 0
    assert not link.is_symlink()


def test_a_wrong_script_leaves_the_port_of_another_emulator_alone(tmp_path: Path) -> None:
    script, link = tmp_path / "script.jsonl", tmp_path / "arm"
    script.write_text('{"at_s": 0, "hand": {"3": 5000}}\n')
    link.symlink_to("/dev/pts/of_another")
    done = run(sys.executable, "-P", "-m", "server.cli", "emulate", "--script", script, "--link", link)
    assert (done.returncode, done.stdout) == (1, "")
    assert f"{script}, line 1: hand.3: must be less than or equal to 4095, not 5000" in done.stderr
    assert str(link.readlink()) == "/dev/pts/of_another"
