from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time

import pytest

from robot.bus import Bus
from robot.emulator.process import LINGER_S, MAX_COMMAND_BYTES, PseudoTerminal
from robot.registers import TELEMETRY_ADDRESS, TELEMETRY_BYTES, Register

IDS = (1, 2, 3, 4, 5, 6)


def test_a_terminal_passes_every_byte_unaltered():
    with contextlib.closing(PseudoTerminal()) as terminal:
        client = os.open(terminal.port, os.O_RDWR | os.O_NOCTTY)
        every_byte = bytes(range(256))
        terminal.write(every_byte)
        assert os.read(client, 512) == every_byte
        os.write(client, every_byte)
        assert terminal.read() == every_byte
        assert terminal.read() == b""
        os.close(client)


def test_bytes_that_nobody_fetches_are_lost_rather_than_waited_for():
    with contextlib.closing(PseudoTerminal()) as terminal:
        for _ in range(100):
            terminal.write(bytes(4096))


def test_a_link_leads_to_the_terminal_as_long_as_it_is_there(tmp_path):
    link = tmp_path / "arm"
    link.symlink_to("/dev/null")
    terminal = PseudoTerminal(link)
    assert str(link.readlink()) == terminal.port
    terminal.close()
    assert not link.is_symlink()


def test_a_file_in_the_place_of_the_link_is_left_alone(tmp_path):
    link = tmp_path / "arm"
    link.write_text("mine")
    with pytest.raises(FileExistsError):
        PseudoTerminal(link)
    assert link.read_text() == "mine"


def test_live_commands_are_answered_while_the_bus_runs(emulator, bus):
    assert emulator.command(drop=1.0) == {"ok": True}
    assert bus.sync_read(IDS, TELEMETRY_ADDRESS, TELEMETRY_BYTES) == {}
    assert "unknown command" in str(emulator.command(nonsense=1)["error"])
    assert emulator.command(drop=0.0) == {"ok": True}
    assert len(bus.sync_read(IDS, TELEMETRY_ADDRESS, TELEMETRY_BYTES)) == 6


def test_an_emulator_let_go_serves_on_until_the_bus_is_silent(emulator, bus):
    emulator.let_go()
    let_go_s = time.monotonic()
    while time.monotonic() < let_go_s + 1.2 * LINGER_S:
        assert bus.ping(1) == 777
    silent_from_s = time.monotonic()
    assert emulator.process.wait(5.0) == 0
    assert time.monotonic() - silent_from_s > 0.9 * LINGER_S


def test_a_controlled_emulator_leaves_ctrl_c_to_its_controller(emulator, bus):
    emulator.process.send_signal(signal.SIGINT)
    assert bus.ping(1) == 777
    emulator.process.terminate()
    assert emulator.process.wait(5.0) == 0


def test_a_controller_that_sends_no_line_end_is_let_go(emulator):
    with contextlib.suppress(OSError):
        emulator._socket.sendall(b"x" * (MAX_COMMAND_BYTES + 4096))
    assert emulator.process.wait(5.0) == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_without_a_controller_it_prints_the_port_and_runs_until_told_to_end(tmp_path, number):
    link = tmp_path / "arm"
    command = [sys.executable, "-P", "-m", "robot.emulator", "--link", str(link)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        port = process.stdout.readline().strip()
        with contextlib.closing(Bus.open(str(link))) as bus:
            assert bus.read(6, Register.ID) == 6
        assert str(link.readlink()) == port
        process.send_signal(number)
        assert process.wait(5.0) == 0
    assert not link.is_symlink()
