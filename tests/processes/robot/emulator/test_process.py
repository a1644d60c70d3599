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
from robot.emulator.process import LINGER_S
from robot.errors import NoReply
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import TELEMETRY_ADDRESS, TELEMETRY_BYTES
from tests.helpers.programs import run

IDS = (1, 2, 3, 4, 5, 6)


@pytest.fixture
def line(terminal):
    with contextlib.closing(Bus.open(terminal.port)) as bus:
        yield bus


def test_live_commands_are_answered_while_the_bus_runs(terminal, line):
    assert terminal.command(drop=1.0) == {"ok": True}
    assert line.sync_read(IDS, TELEMETRY_ADDRESS, TELEMETRY_BYTES) == {}
    assert "unknown command" in str(terminal.command(nonsense=1)["error"])
    assert terminal.command(drop=0.0) == {"ok": True}
    assert len(line.sync_read(IDS, TELEMETRY_ADDRESS, TELEMETRY_BYTES)) == 6


def test_an_emulator_let_go_serves_on_until_the_bus_is_silent(terminal, line):
    terminal.let_go()
    let_go_s = time.monotonic()
    asked_s = let_go_s
    while asked_s < let_go_s + 0.2 * LINGER_S:
        asked_s = time.monotonic()
        assert line.ping(1) == 777
    assert terminal.process.wait(TIMEOUT_S) == 0
    # It heard the last ping after that was asked, however long this process then waited for its turn.
    assert time.monotonic() - asked_s >= LINGER_S


def test_a_controlled_emulator_leaves_ctrl_c_to_its_controller(terminal, line):
    terminal.process.send_signal(signal.SIGINT)
    assert line.ping(1) == 777
    terminal.process.terminate()
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
        with contextlib.closing(Bus.open(str(link))) as bus:
            assert bus.ping(5) == 777
            with pytest.raises(NoReply):
                bus.ping(6)
        process.terminate()
        assert process.wait(TIMEOUT_S) == 0
    assert not link.is_symlink()


def test_a_process_plays_a_script_from_the_first_byte_of_a_host_on_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    script, link = tmp_path / "script.jsonl", tmp_path / "arm"
    script.write_text('{"at_s": 2.0, "offline": [6]}\n')
    with standalone("--script", str(script), "--link", str(link)) as (process, port):
        # Longer than the script waits, which begins with the first byte.
        time.sleep(2.1)
        with contextlib.closing(Bus.open(port)) as bus:
            # The emulator may be without a core for a while.
            assert bus.ping(6, attempts=50) == 777
            time.sleep(2.1)
            with pytest.raises(NoReply):
                bus.ping(6)
        process.send_signal(signal.SIGINT)
        _, shown = process.communicate(timeout=TIMEOUT_S)
        assert shown == '2.0 s: {"offline": [6]} {"ok": true}\n'
        assert process.returncode == 0
    assert not link.is_symlink()


def test_a_wrong_script_leaves_the_port_of_another_emulator_alone(tmp_path: Path) -> None:
    script, link = tmp_path / "script.jsonl", tmp_path / "arm"
    script.write_text('{"at_s": 0, "hand": {"3": 5000}}\n')
    link.symlink_to("/dev/pts/of_another")
    done = run(sys.executable, "-P", "-m", "server.cli", "emulate", "--script", script, "--link", link)
    assert (done.returncode, done.stdout) == (1, "")
    assert f"{script}, line 1: hand.3: must be less than or equal to 4095, not 5000" in done.stderr
    assert str(link.readlink()) == "/dev/pts/of_another"
