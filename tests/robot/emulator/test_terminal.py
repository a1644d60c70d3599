from __future__ import annotations

import contextlib
import os

import pytest
import serial

from robot.emulator.terminal import PseudoTerminal


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


@pytest.mark.parametrize(("set_to", "seen"), [(1_000_000, 1_000_000), (115_200, 115_200), (9600, 0)])
def test_the_baud_rate_is_the_one_that_the_client_sets(set_to, seen):
    with contextlib.closing(PseudoTerminal()) as terminal, serial.Serial(terminal.port, set_to):
        assert terminal.baudrate == seen


def test_a_link_leads_to_the_terminal_as_long_as_it_is_there(tmp_path):
    link = tmp_path / "arm"
    link.symlink_to("/dev/null")
    terminal = PseudoTerminal(link)
    assert str(link.readlink()) == terminal.port
    terminal.close()
    assert not link.is_symlink()


def test_a_link_that_was_left_stays(tmp_path):
    link = tmp_path / "arm"
    terminal = PseudoTerminal(link)
    terminal.leave_link()
    terminal.close()
    assert link.is_symlink()


def test_a_file_in_the_place_of_the_link_is_left_alone(tmp_path):
    link = tmp_path / "arm"
    link.write_text("mine")
    with pytest.raises(FileExistsError):
        PseudoTerminal(link)
    assert link.read_text() == "mine"
