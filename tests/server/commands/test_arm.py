import functools
import itertools
import signal

import pytest

from harness.server import read_write_log
from robot.calibration import save
from robot.hardware.dynamixel import registers as dynamixel_registers
from robot.hardware.dynamixel.family import Dynamixel
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import run_to_end
from server import cli
from server.commands import arm
from server.commands.terminal import ExitCode
from tests.helpers.dynamixel import SteppedDynamixels
from tests.helpers.robots import nominal_calibration


def test_a_scan_is_a_table_of_the_servos_and_names_the_missing_with_their_cause(emulator, armbridge):
    answer = armbridge("scan")
    assert (answer.returncode, answer.stderr.count("\n")) == (ExitCode.DONE, 1)
    assert len(answer.stdout.splitlines()) == 7
    assert "elbow_flex" in answer.stdout
    emulator.command(offline=[3, 4, 5, 6])
    answer = armbridge("scan")
    assert (answer.returncode, len(answer.stdout.splitlines())) == (ExitCode.PROBLEMS, 3)
    assert "3 (elbow_flex), 4 (wrist_flex)" in answer.stderr
    assert "cable that leads to it" in answer.stderr


def test_a_port_that_is_not_there_is_one_line_and_exit_1(capsys, tmp_path):
    assert cli.main(["scan", "--serial", str(tmp_path / "none")]) == ExitCode.FAILED
    assert capsys.readouterr().err.splitlines()[-1].startswith("armbridge: serial port")


def test_every_baud_rate_is_looked_at_on_request(armbridge, bus):
    for register, value in ((55, 0), (6, 1)):
        bus.sync_write(register, {5: bytes([value])})
    answer = armbridge("scan", "--all-bauds")
    assert answer.returncode == ExitCode.PROBLEMS
    assert "servo 5 listens at 500000 baud" in answer.stderr


def test_an_examination_writes_nothing_and_lists_problems_with_what_to_do(
    emulator, armbridge, tmp_path, write_log, monkeypatch
):
    monkeypatch.setattr("server.commands.arm.CYCLES", 20)
    save(nominal_calibration(), tmp_path / "arm.json")
    emulator.command(temperature={"2": 70})
    answer = armbridge("doctor", "--calibration", str(tmp_path / "arm.json"))
    assert answer.returncode == ExitCode.PROBLEMS
    assert "verdict" in answer.stdout
    assert "problem  temperature" in answer.stdout
    assert "* temperature: Let the arm cool without torque" in answer.stdout
    assert "the servos hold what the file says" in answer.stdout
    assert [each["instruction"] for each in read_write_log(write_log)] == ["command"]


def test_an_arm_that_does_not_answer_is_a_finding_and_cannot_be_relaxed(emulator, armbridge):
    emulator.command(offline=list(IDS))
    answer = armbridge("doctor", "--json")
    assert answer.returncode == ExitCode.PROBLEMS
    assert "power supply" in answer.stdout
    answer = armbridge("relax")
    assert answer.returncode == ExitCode.FAILED
    assert "no servo answers" in answer.stderr


def test_an_unknown_calibration_is_refused(armbridge):
    answer = armbridge("doctor", "--calibration", "nobodys")
    assert (answer.returncode, "lerobot has no calibration of that id" in answer.stderr) == (ExitCode.USAGE, True)


IDS = (1, 2, 3, 4, 5, 6)


def hold(bus):
    """Have the arm hold where it is, without a program that drives it."""
    for servo_id in IDS:
        bus.write(servo_id, Register.GOAL_POSITION, bus.read(servo_id, Register.PRESENT_POSITION))
        bus.write(servo_id, Register.TORQUE_ENABLE, 1)


def torque(bus):
    return [bus.read(servo_id, Register.TORQUE_ENABLE) for servo_id in IDS]


def test_an_arm_that_holds_is_relaxed_and_then_left_alone(armbridge, bus, write_log):
    hold(bus)
    answer = armbridge("relax")
    assert (answer.returncode, answer.stderr.splitlines()[-1]) == (ExitCode.DONE, "torque is off on all servos")
    assert torque(bus) == [0] * 6
    written = write_log.read_text()
    assert written
    assert armbridge("relax").returncode == ExitCode.DONE
    assert write_log.read_text() == written


def test_an_arm_is_relaxed_to_the_end_before_ctrl_c_is_taken(armbridge, emulator, bus, monkeypatch):
    hold(bus)
    waits = itertools.count()

    def wait(wait_s):
        emulator.run(wait_s)
        if next(waits) == 30:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(arm, "run_to_end", functools.partial(run_to_end, wait=wait))
    assert armbridge("relax").returncode == ExitCode.FAILED
    assert torque(bus) == [0] * 6
    assert min(bus.read(servo_id, Register.TORQUE_LIMIT) for servo_id in IDS) >= 500


def test_a_servo_that_does_not_confirm_is_named_as_perhaps_driven(armbridge, emulator, bus):
    hold(bus)
    emulator.command(offline=[4])
    answer = armbridge("relax")
    assert answer.returncode == ExitCode.PROBLEMS
    assert "wrist_flex (id 4) may still be driven" in answer.stderr
    emulator.command(online=[4])
    assert torque(bus) == [0, 0, 0, 1, 0, 0]


def test_dynamixel_servos_are_relaxed_gently_also_after_their_watchdogs_have_stopped_them(monkeypatch, capsys):
    dynamixels = SteppedDynamixels()
    bus, registers = dynamixels.open_bus(), dynamixel_registers.Register
    for servo_id in IDS:
        bus.write(servo_id, registers.TORQUE_ENABLE, 1)
        bus.write(servo_id, registers.BUS_WATCHDOG, 25)
    dynamixels.run(1.0)
    lowered = []

    def wait(wait_s):
        dynamixels.run(wait_s)
        lowered.append(dynamixels.registers(registers.GOAL_PWM)[0])

    monkeypatch.setattr(Dynamixel.bus, "open", lambda _port, _baud: dynamixels.open_bus())
    monkeypatch.setattr(arm, "run_to_end", functools.partial(run_to_end, wait=wait))
    assert cli.main(["relax", "--robot", "koch_v1_1", "--serial", "/dev/stepped"]) == ExitCode.DONE
    assert capsys.readouterr().err.splitlines()[-1] == "torque is off on all servos"
    assert dynamixels.registers(registers.TORQUE_ENABLE) == [0] * 6
    assert len(set(lowered)) > 10


@pytest.mark.parametrize("command", ["scan", "setup", "calibrate", "doctor"])
def test_a_command_for_feetech_servos_alone_says_so(command, capsys):
    with pytest.raises(SystemExit):
        cli.main([command, "--help"])
    assert "For Feetech servos only." in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("command", [("relax",), ("doctor",), ("serve", "--port", "0")])
def test_a_robot_that_cannot_be_read_has_the_same_exit_code_with_every_command(command, tmp_path):
    (tmp_path / "robot.toml").write_text("no TOML")
    assert cli.main([*command, "--robot", str(tmp_path)]) == ExitCode.USAGE
