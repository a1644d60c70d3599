from __future__ import annotations

import json
from dataclasses import replace

import pytest

from robot.calibration import Calibration
from robot.description.gravity import LinkWeights
from robot.emulator.arm import DUTY_PERMILLE_PER_NM, build_servos, weight_of
from robot.hardware.feetech.registers import Register
from tests.helpers.robots import SO101_SERVOS, nominal_calibration, so101

JOINTS = [servo.joint for servo in SO101_SERVOS]


def test_servos_stand_at_the_pose_asked_for():
    pose = [0.3, -0.5, 0.5, 0.2, 1.0, 1.5]
    calibration = nominal_calibration()
    for servo, joint, position in zip(build_servos(calibration, pose), calibration.joints, pose, strict=True):
        assert servo.servo_id == joint.servo_id
        assert joint.rad_from_ticks(servo.present_ticks) == pytest.approx(position, abs=0.001)
        assert servo.value(Register.MIN_ANGLE_LIMIT) == joint.range_min
        assert servo.value(Register.MAX_ANGLE_LIMIT) == joint.range_max


@pytest.fixture
def offset_calibration(tmp_path):
    entry = {"drive_mode": 0, "homing_offset": -120, "range_min": 900, "range_max": 3000}
    path = tmp_path / "arm.json"
    path.write_text(json.dumps({spec.joint: {"id": spec.servo_id + 10, **entry} for spec in SO101_SERVOS}))
    return Calibration.load(path, SO101_SERVOS)


def test_a_calibration_gives_the_servos_its_offsets_and_ranges(offset_calibration):
    servo = build_servos(offset_calibration, [0.0] * 6)[0]
    assert (servo.servo_id, servo.present_ticks, servo.value(Register.HOMING_OFFSET)) == (11, 1950, -120)


def gravity_permille(calibration, pose):
    servos = build_servos(calibration, pose)
    weight_of(so101(), calibration, servos)()
    return [servo.plant.gravity_permille for servo in servos]


def test_the_weight_follows_the_pose_whatever_the_offsets(offset_calibration):
    pose = [0.0, 0.7, -0.4, 0.3, 0.0, 0.0]
    torques_nm = LinkWeights(so101()).holding_torques(dict(zip(JOINTS, pose, strict=True)))
    expected = [DUTY_PERMILLE_PER_NM * torques_nm[joint] for joint in JOINTS]
    assert gravity_permille(offset_calibration, pose) == pytest.approx(expected, abs=0.1)


def test_a_servo_whose_ticks_fall_is_loaded_the_other_way():
    mirrored = [replace(servo, sign=-1) for servo in SO101_SERVOS]
    pose = [0.0, 0.7, -0.4, 0.3, 0.0, 0.5]
    plain, other = (gravity_permille(Calibration.nominal(servos), pose) for servos in (SO101_SERVOS, mirrored))
    assert abs(plain[1]) > 1.0
    assert other == pytest.approx([-permille for permille in plain], abs=0.1)


def test_the_weight_is_put_on_again_when_the_arm_has_moved():
    calibration = nominal_calibration()
    servos = build_servos(calibration, [0.0] * 6)
    weigh = weight_of(so101(), calibration, servos)
    weigh()
    before = servos[1].plant.gravity_permille
    servos[1].plant.position_ticks += 500
    weigh()
    assert servos[1].plant.gravity_permille < before - 1.0
