from __future__ import annotations

import contextlib
import json
import os

import pytest

from robot.calibration import Calibration, save
from robot.commissioning.doctor import EXPERIMENTS
from robot.emulator.plant import HAND_TICKS_S
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import Register
from server import cli
from server.commands import arm
from server.commands.terminal import ExitCode
from tests.helpers.robots import SO101_SERVOS, nominal_calibration
from tests.helpers.server import read_write_log


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


SWEPT = [spec.servo_id for spec in SO101_SERVOS if spec.joint != "wrist_roll"]
MIDDLE = {str(spec.servo_id): 2040 for spec in SO101_SERVOS}

# What one joint is moved by from the middle, to either side [ticks].
REACH = 500


@pytest.fixture
def sweeping(emulator, monkeypatch):
    """The input of a person who sweeps stepped servos while the command sleeps between its readings."""
    emulator.command(hand=MIDDLE)
    emulator.run(1.0)
    moves = iter([+REACH, -REACH])
    read_end, write_end = os.pipe()
    os.write(write_end, b"\n")

    def sleep(_seconds):
        if (reach := next(moves, None)) is None:
            os.write(write_end, b"\n")
        else:
            emulator.command(hand={str(servo): 2040 + reach for servo in SWEPT})
            emulator.run(2 * REACH / HAND_TICKS_S + 0.1)

    monkeypatch.setattr(arm.time, "sleep", sleep)
    yield read_end
    for descriptor in (read_end, write_end):
        os.close(descriptor)


def held(bus, servo_id):
    registers = Register.HOMING_OFFSET, Register.MIN_ANGLE_LIMIT, Register.MAX_ANGLE_LIMIT
    return tuple(bus.read(servo_id, register) for register in registers)


def test_a_sweep_by_hand_becomes_a_file_and_leaves_the_servos_alone(armbridge, sweeping, bus, tmp_path):
    before = held(bus, 3)
    answer = armbridge("calibrate", str(tmp_path / "arm.json"), "--yes", descriptor=sweeping)
    assert answer.returncode == ExitCode.DONE
    elbow = Calibration.load(tmp_path / "arm.json", SO101_SERVOS).joints[2]
    assert (elbow.range_min, elbow.range_max) == pytest.approx((2040 - REACH, 2040 + REACH), abs=20)
    assert str(elbow.range_min) in answer.stdout
    assert held(bus, 3) == before


def test_on_request_the_servos_get_what_the_file_says(armbridge, sweeping, bus, tmp_path):
    answer = armbridge("calibrate", str(tmp_path / "arm.json"), "--yes", "--write-servos", descriptor=sweeping)
    assert answer.returncode == ExitCode.DONE
    elbow = Calibration.load(tmp_path / "arm.json", SO101_SERVOS).joints[2]
    assert elbow.homing_offset == pytest.approx(2040 - 2047, abs=20)
    assert held(bus, 3) == (elbow.homing_offset, elbow.range_min, elbow.range_max)


def test_a_file_that_is_there_is_not_replaced(armbridge, tmp_path):
    file = tmp_path / "arm.json"
    file.write_text("mine")
    answer = armbridge("calibrate", str(file))
    assert answer.returncode == ExitCode.FAILED
    assert "--overwrite" in answer.stderr
    assert file.read_text() == "mine"


def test_torque_stays_as_it_is_without_a_yes(armbridge, tmp_path):
    answer = armbridge("calibrate", str(tmp_path / "arm.json"), answers="n\n")
    assert answer.returncode == ExitCode.FAILED
    assert "relaxing" not in answer.stderr


def test_an_arm_that_is_not_moved_is_not_calibrated(armbridge, tmp_path):
    answer = armbridge("calibrate", str(tmp_path / "arm.json"), "--yes", answers="\n\n")
    assert answer.returncode == ExitCode.FAILED
    assert "move every joint from stop to stop" in answer.stderr
    assert not (tmp_path / "arm.json").exists()


def test_an_arm_that_lacks_a_servo_is_not_calibrated(armbridge, emulator, tmp_path):
    emulator.command(offline=[2])
    answer = armbridge("calibrate", str(tmp_path / "a.json"))
    assert answer.returncode == ExitCode.FAILED
    assert "2 (shoulder_lift)" in answer.stderr


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


def test_nothing_is_asked_of_the_arm_without_a_yes(armbridge):
    answer = armbridge("doctor", "--json", *QUICK, answers="no\n" * len(EXPERIMENTS))
    found = findings(answer.stdout)
    assert all(found[experiment.name]["says"] == "not asked" for experiment in EXPERIMENTS)
    assert answer.stderr.count("[y/N]") == len(EXPERIMENTS)


def test_a_question_is_asked_of_the_arm_after_a_yes(armbridge):
    answer = armbridge("doctor", "--json", *QUICK, answers="y\n" + "\n" * len(EXPERIMENTS))
    assert findings(answer.stdout)[EXPERIMENTS[0].name]["says"] == "those behind it answer"


def test_questions_that_nobody_answers_end_the_command(armbridge):
    answer = armbridge("doctor", *QUICK)
    assert answer.returncode == ExitCode.FAILED
    assert "the input ended" in answer.stderr


def test_a_read_only_visit_writes_nothing(armbridge, write_log):
    answer = armbridge("doctor", "--read-only", *QUICK)
    assert write_log.exists()
    assert read_write_log(write_log) == []
    assert "verdict" in answer.stdout


def test_problems_are_listed_with_what_to_do_and_exit_3(emulator, armbridge, tmp_path):
    file = tmp_path / "arm.json"
    save(nominal_calibration(), file)
    emulator.command(temperature={"2": 70})
    answer = armbridge("doctor", "--calibration", str(file), "--read-only", *QUICK)
    assert answer.returncode == ExitCode.PROBLEMS
    assert "problem  temperature" in answer.stdout
    assert "* temperature: Relax the arm" in answer.stdout
    assert "the servos hold what the file says" in answer.stdout


def test_an_arm_that_does_not_answer_is_a_finding_and_no_failure(emulator, armbridge):
    emulator.command(offline=[1, 2, 3, 4, 5, 6])
    answer = armbridge("doctor", "--json")
    assert answer.returncode == ExitCode.PROBLEMS
    assert "power supply" in answer.stdout


def test_a_calibration_that_is_not_there_is_refused(armbridge):
    answer = armbridge("doctor", "--calibration", "nobodys")
    assert answer.returncode == ExitCode.FAILED
    assert "lerobot has none of that id" in answer.stderr


def test_less_than_one_cycle_is_called_wrongly(capsys):
    assert cli.main(["doctor", "--cycles", "0"]) == ExitCode.USAGE


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
