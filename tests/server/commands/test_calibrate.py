from __future__ import annotations

import os

import pytest

from robot.calibration import SO101_JOINTS, Calibration
from robot.emulator.plant import HAND_TICKS_S
from robot.hardware.feetech.registers import Register
from server.commands import calibrate
from server.commands.terminal import ExitCode

SWEPT = [spec.servo_id for spec in SO101_JOINTS if spec.name != "wrist_roll"]
MIDDLE = {str(spec.servo_id): 2040 for spec in SO101_JOINTS}

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

    monkeypatch.setattr(calibrate.time, "sleep", sleep)
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
    elbow = Calibration.load(tmp_path / "arm.json").joints[2]
    assert (elbow.range_min, elbow.range_max) == pytest.approx((2040 - REACH, 2040 + REACH), abs=20)
    assert str(elbow.range_min) in answer.stdout
    assert held(bus, 3) == before


def test_on_request_the_servos_get_what_the_file_says(armbridge, sweeping, bus, tmp_path):
    answer = armbridge("calibrate", str(tmp_path / "arm.json"), "--yes", "--write-servos", descriptor=sweeping)
    assert answer.returncode == ExitCode.DONE
    elbow = Calibration.load(tmp_path / "arm.json").joints[2]
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
