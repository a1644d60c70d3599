from __future__ import annotations

import pytest

from robot.servos.bus import Bus
from robot.servos.registers import Register
from server import cli
from server.commands.terminal import ExitCode

IDS = (1, 2, 3, 4, 5, 6)


@pytest.fixture
def holding(emulator):
    """The port of an arm that holds where it is, without a program that drives it."""
    bus = Bus.open(emulator.port)
    for servo_id in IDS:
        bus.write(servo_id, Register.GOAL_POSITION, bus.read(servo_id, Register.PRESENT_POSITION))
        bus.write(servo_id, Register.TORQUE_ENABLE, 1)
    bus.close()
    return emulator.port


def torque(port):
    bus = Bus.open(port)
    enabled = [bus.read(servo_id, Register.TORQUE_ENABLE) for servo_id in IDS]
    bus.close()
    return enabled


def test_an_arm_that_holds_is_relaxed(holding, armbridge):
    answer = armbridge("relax")
    assert answer.returncode == ExitCode.DONE
    assert answer.stderr.splitlines()[-1] == "torque is off on all servos"
    assert torque(holding) == [0] * 6


def test_an_arm_that_is_relaxed_is_left_alone(emulator, start_emulator, write_log, capsys):
    port = start_emulator("--write-log", str(write_log)).port
    assert cli.main(["relax", "--serial", port]) == ExitCode.DONE
    assert write_log.read_text() == ""


def test_a_servo_that_does_not_confirm_is_named_as_perhaps_driven(holding, emulator, capsys):
    emulator.command(offline=[4])
    assert cli.main(["relax", "--serial", holding]) == ExitCode.PROBLEMS
    assert "wrist_flex (id 4) may still be driven" in capsys.readouterr().err
    emulator.command(online=[4])
    assert torque(holding) == [0, 0, 0, 1, 0, 0]


def test_a_bus_without_servos_cannot_be_relaxed(emulator, capsys):
    emulator.command(offline=list(IDS))
    assert cli.main(["relax", "--serial", emulator.port]) == ExitCode.FAILED
    assert "no servo answers" in capsys.readouterr().err
