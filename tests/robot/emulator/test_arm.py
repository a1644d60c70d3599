from __future__ import annotations

import json
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.calibration import SO101_JOINTS, Calibration
from robot.description.model import builtin
from robot.emulator.arm import DUTY_PERMILLE_PER_NM, build_servos, holding_duty_permille, weight_of
from robot.hardware.feetech.registers import Register

with warnings.catch_warnings(action="ignore"):  # of its own imports
    import pinocchio

JOINTS = ("shoulder_lift", "elbow_flex", "wrist_flex")
MODEL = pinocchio.buildModelFromXML(builtin().urdf)
DATA = MODEL.createData()
ANGLE = st.floats(-1.6, 1.6)


@given(ANGLE, ANGLE, ANGLE)
def test_the_weight_is_that_of_the_links_in_the_urdf(lift, elbow, wrist):
    position = np.array([0.0, lift, elbow, wrist, 0.0, 0.0])
    torque_nm = pinocchio.computeGeneralizedGravity(MODEL, DATA, position)
    duty = holding_duty_permille(dict(zip(JOINTS, (lift, elbow, wrist), strict=True)))
    for joint in JOINTS:
        expected = torque_nm[MODEL.joints[MODEL.getJointId(joint)].idx_v]
        assert duty[joint] / DUTY_PERMILLE_PER_NM == pytest.approx(expected, abs=0.08)


def test_an_arm_upright_weighs_little_and_a_stretched_one_most():
    upright = holding_duty_permille({"shoulder_lift": -0.22, "elbow_flex": -1.35, "wrist_flex": 0.0})
    stretched = holding_duty_permille({"shoulder_lift": 1.35, "elbow_flex": -1.35, "wrist_flex": 0.0})
    assert abs(upright["shoulder_lift"]) < 0.1 * abs(stretched["shoulder_lift"])


def test_servos_stand_at_the_pose_asked_for():
    pose = [0.3, -0.5, 0.5, 0.2, 1.0, 1.5]
    calibration = Calibration.nominal()
    for servo, joint, position in zip(build_servos(calibration, pose), calibration.joints, pose, strict=True):
        assert servo.servo_id == joint.servo_id
        assert joint.rad_from_ticks(servo.present_ticks) == pytest.approx(position, abs=0.001)
        assert servo.value(Register.MIN_ANGLE_LIMIT) == joint.range_min
        assert servo.value(Register.MAX_ANGLE_LIMIT) == joint.range_max


@pytest.fixture
def offset_calibration(tmp_path):
    entry = {"drive_mode": 0, "homing_offset": -120, "range_min": 900, "range_max": 3000}
    path = tmp_path / "arm.json"
    path.write_text(json.dumps({spec.name: {"id": spec.servo_id + 10, **entry} for spec in SO101_JOINTS}))
    return Calibration.load(path)


def test_a_calibration_gives_the_servos_its_offsets_and_ranges(offset_calibration):
    servo = build_servos(offset_calibration, [0.0] * 6)[0]
    assert (servo.servo_id, servo.present_ticks, servo.value(Register.HOMING_OFFSET)) == (11, 1950, -120)


def test_the_weight_follows_the_pose_whatever_the_offsets(offset_calibration):
    pose = [0.0, 0.7, -0.4, 0.3, 0.0, 0.0]
    servos = build_servos(offset_calibration, pose)
    weight_of(offset_calibration, servos)()
    expected = holding_duty_permille(
        {joint.joint: position for joint, position in zip(offset_calibration.joints, pose, strict=True)}
    )
    for joint, servo in zip(offset_calibration.joints, servos, strict=True):
        assert servo.plant.gravity_permille == pytest.approx(expected.get(joint.joint, 0.0), abs=0.1)
