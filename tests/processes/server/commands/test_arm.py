"""Commands as processes on servos behind a pseudo terminal."""

from __future__ import annotations

import contextlib
import json

from robot.commissioning.experiments import EXPERIMENTS
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import Register
from server import cli
from server.commands.terminal import ExitCode


def test_an_arm_that_is_well_is_a_table_and_exit_0(armbridge_on_terminal):
    answer = armbridge_on_terminal("scan")
    assert answer.returncode == ExitCode.DONE
    assert len(answer.stdout.splitlines()) == 7
    assert "elbow_flex" in answer.stdout
    assert answer.stderr.count("\n") == 1


def test_a_bus_in_use_is_told_from_one_that_is_not_there(terminal, capsys):
    with contextlib.closing(Bus.open(terminal.port)):
        assert cli.main(["scan", "--serial", terminal.port]) == ExitCode.FAILED
    assert "in use by another process" in capsys.readouterr().err


QUICK = ("--cycles", "20")


def findings(text):
    return {each["check"]: each for each in json.loads(text)}


def test_every_check_and_every_question_has_a_finding(armbridge_on_terminal):
    answer = armbridge_on_terminal("doctor", "--yes", "--json", *QUICK)
    found = findings(answer.stdout)
    assert {experiment.name for experiment in EXPERIMENTS} < set(found)
    assert found["servos"]["verdict"] == found["long reads"]["verdict"] == "good"
    assert found["torque at power-up"]["says"] == "not asked"
    assert "it works" in found["return delay register"]["says"]


IDS = (1, 2, 3, 4, 5, 6)


def hold(bus):
    """Have the arm hold where it is, without a program that drives it."""
    for servo_id in IDS:
        bus.write(servo_id, Register.GOAL_POSITION, bus.read(servo_id, Register.PRESENT_POSITION))
        bus.write(servo_id, Register.TORQUE_ENABLE, 1)


def torque(bus):
    return [bus.read(servo_id, Register.TORQUE_ENABLE) for servo_id in IDS]


def test_an_arm_that_holds_is_relaxed(terminal, armbridge_on_terminal):
    with contextlib.closing(Bus.open(terminal.port)) as bus:
        hold(bus)
    answer = armbridge_on_terminal("relax")
    assert answer.returncode == ExitCode.DONE
    assert answer.stderr.splitlines()[-1] == "torque is off on all servos"
    with contextlib.closing(Bus.open(terminal.port)) as bus:
        assert torque(bus) == [0] * 6
