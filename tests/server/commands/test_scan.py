from __future__ import annotations

import contextlib

from robot.hardware.feetech.bus import Bus
from server import cli
from server.commands.terminal import ExitCode


def test_an_arm_that_is_well_is_a_table_and_exit_0(armbridge_on_terminal):
    answer = armbridge_on_terminal("scan")
    assert answer.returncode == ExitCode.DONE
    assert len(answer.stdout.splitlines()) == 7
    assert "elbow_flex" in answer.stdout
    assert answer.stderr.count("\n") == 1


def test_a_missing_servo_is_named_with_its_cause_and_exit_3(emulator, armbridge):
    emulator.command(offline=[3, 4, 5, 6])
    answer = armbridge("scan")
    assert answer.returncode == ExitCode.PROBLEMS
    assert "3 (elbow_flex), 4 (wrist_flex)" in answer.stderr
    assert "cable that leads to it" in answer.stderr
    assert len(answer.stdout.splitlines()) == 3


def test_a_port_that_is_not_there_is_one_line_and_exit_1(capsys, tmp_path):
    assert cli.main(["scan", "--serial", str(tmp_path / "none")]) == ExitCode.FAILED
    assert capsys.readouterr().err.splitlines()[-1].startswith("armbridge: serial port")


def test_a_bus_in_use_is_told_from_one_that_is_not_there(terminal, capsys):
    with contextlib.closing(Bus.open(terminal.port)):
        assert cli.main(["scan", "--serial", terminal.port]) == ExitCode.FAILED
    assert "in use by another process" in capsys.readouterr().err


def test_every_baud_rate_is_looked_at_on_request(armbridge, bus):
    for register, value in ((55, 0), (6, 1)):
        bus.sync_write(register, {5: bytes([value])})
    answer = armbridge("scan", "--all-bauds")
    assert answer.returncode == ExitCode.PROBLEMS
    assert "servo 5 listens at 500000 baud" in answer.stderr
