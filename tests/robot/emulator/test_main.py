from __future__ import annotations

import json

import pytest

from robot.calibration import SO101_JOINTS, Calibration
from robot.emulator.__main__ import build_servos, main
from robot.registers import Register


def test_servos_stand_at_the_pose_asked_for():
    pose = [0.3, -0.5, 0.5, 0.2, 1.0, 1.5]
    calibration = Calibration.nominal()
    for servo, joint, position in zip(build_servos(calibration, pose), calibration.joints, pose, strict=True):
        assert servo.servo_id == joint.servo_id
        assert joint.rad_from_ticks(servo.present_ticks) == pytest.approx(position, abs=0.001)
        assert servo.value(Register.MIN_ANGLE_LIMIT) == joint.range_min
        assert servo.value(Register.MAX_ANGLE_LIMIT) == joint.range_max


def test_a_calibration_gives_the_servos_its_offsets_and_ranges(tmp_path):
    entry = {"drive_mode": 0, "homing_offset": -120, "range_min": 900, "range_max": 3000}
    path = tmp_path / "arm.json"
    path.write_text(json.dumps({spec.name: {"id": spec.servo_id + 10, **entry} for spec in SO101_JOINTS}))
    servo = build_servos(Calibration.load(path), [0.0] * 6)[0]
    assert (servo.servo_id, servo.present_ticks, servo.value(Register.HOMING_OFFSET)) == (11, 1950, -120)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--start=0,0,0"], "needs 6 positions, not 3"),
        (["--start=0,9,0,0,0,0"], "shoulder_lift cannot start at 9 rad"),
        (["--start=a"], "not a list of numbers"),
        (["--drop", "2"], "not a probability"),
        (["--calibration", "/nowhere.json"], "/nowhere.json: cannot be read"),
        (["--write-log", "/nowhere/log"], "/nowhere/log"),
    ],
)
def test_options_that_cannot_be_are_refused_in_a_sentence(capsys, arguments, sentence):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert sentence in capsys.readouterr().err


def test_help_names_every_option(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    for option in ("drop", "corrupt", "seed", "start", "calibration", "write-log", "link", "control-fd"):
        assert f"--{option}" in printed
