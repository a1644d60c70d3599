from __future__ import annotations

import contextlib

from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import Register
from server.commands.terminal import ExitCode

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


def test_an_arm_that_is_relaxed_is_left_alone(armbridge, write_log):
    assert armbridge("relax").returncode == ExitCode.DONE
    assert write_log.read_text() == ""


def test_a_servo_that_does_not_confirm_is_named_as_perhaps_driven(armbridge, emulator, bus):
    hold(bus)
    emulator.command(offline=[4])
    answer = armbridge("relax")
    assert answer.returncode == ExitCode.PROBLEMS
    assert "wrist_flex (id 4) may still be driven" in answer.stderr
    emulator.command(online=[4])
    assert torque(bus) == [0, 0, 0, 1, 0, 0]


def test_a_bus_without_servos_cannot_be_relaxed(armbridge, emulator):
    emulator.command(offline=list(IDS))
    answer = armbridge("relax")
    assert answer.returncode == ExitCode.FAILED
    assert "no servo answers" in answer.stderr
