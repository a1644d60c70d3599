from __future__ import annotations

import subprocess
import sys
import time

import pytest

from robot.calibration import SO101_JOINTS, Calibration
from robot.emulator.plant import HAND_TICKS_S
from robot.servos.bus import Bus
from robot.servos.registers import Register
from server import cli
from server.commands.terminal import ExitCode

SWEPT = [spec.servo_id for spec in SO101_JOINTS if spec.name != "wrist_roll"]
MIDDLE = {str(spec.servo_id): 2040 for spec in SO101_JOINTS}

# What one joint is moved by from the middle, to either side [ticks].
REACH = 500


class Person:
    """Runs the command, reads what it asks for, and moves the emulated arm by hand."""

    def __init__(self, emulator, *options):
        self.emulator = emulator
        self.process = subprocess.Popen(
            [sys.executable, "-m", "server.cli", "calibrate", "--serial", emulator.port, *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.said = ""

    def read_until(self, words):
        for line in self.process.stderr:
            self.said += line
            if words in line:
                return
        raise AssertionError(self.said)

    def press_enter(self):
        self.process.stdin.write("\n")
        self.process.stdin.flush()

    def sweep(self):
        self.read_until("middle of its range")
        self.move(MIDDLE, from_afar_ticks=600)
        self.press_enter()
        self.read_until("Move every joint")
        self.move({str(servo): 2040 + REACH for servo in SWEPT}, REACH)
        self.move({str(servo): 2040 - REACH for servo in SWEPT}, 2 * REACH)
        self.press_enter()

    def move(self, hand, from_afar_ticks):
        assert self.emulator.command(hand=hand) == {"ok": True}
        time.sleep(from_afar_ticks / HAND_TICKS_S + 0.15)

    def finish(self):
        out, said = self.process.communicate(timeout=20)
        self.said += said
        return self.process.returncode, out


@pytest.fixture
def calibrated(emulator, tmp_path):
    people = []

    def sweep(*options):
        person = Person(emulator, str(tmp_path / "arm.json"), "--yes", *options)
        people.append(person)
        person.sweep()
        return person.finish()

    yield sweep
    for person in people:
        person.process.kill()
        person.process.communicate()


def held(emulator, servo_id):
    bus = Bus.open(emulator.port)
    registers = Register.HOMING_OFFSET, Register.MIN_ANGLE_LIMIT, Register.MAX_ANGLE_LIMIT
    values = tuple(bus.read(servo_id, register) for register in registers)
    bus.close()
    return values


def test_a_sweep_by_hand_becomes_a_file_and_leaves_the_servos_alone(calibrated, emulator, tmp_path):
    before = held(emulator, 3)
    code, out = calibrated()
    assert code == ExitCode.DONE
    elbow = Calibration.load(tmp_path / "arm.json").joints[2]
    assert (elbow.range_min, elbow.range_max) == pytest.approx((2040 - REACH, 2040 + REACH), abs=20)
    assert str(elbow.range_min) in out
    assert held(emulator, 3) == before


def test_on_request_the_servos_get_what_the_file_says(calibrated, emulator, tmp_path):
    code, _ = calibrated("--write-servos")
    assert code == ExitCode.DONE
    elbow = Calibration.load(tmp_path / "arm.json").joints[2]
    assert elbow.homing_offset == pytest.approx(2040 - 2047, abs=20)
    assert held(emulator, 3) == (elbow.homing_offset, elbow.range_min, elbow.range_max)


def test_a_file_that_is_there_is_not_replaced(emulator, tmp_path, capsys):
    file = tmp_path / "arm.json"
    file.write_text("mine")
    assert cli.main(["calibrate", str(file), "--serial", emulator.port]) == ExitCode.FAILED
    assert "--overwrite" in capsys.readouterr().err
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


def test_an_arm_that_lacks_a_servo_is_not_calibrated(emulator, tmp_path, capsys):
    emulator.command(offline=[2])
    assert cli.main(["calibrate", str(tmp_path / "a.json"), "--serial", emulator.port]) == ExitCode.FAILED
    assert "2 (shoulder_lift)" in capsys.readouterr().err
