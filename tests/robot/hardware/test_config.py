from __future__ import annotations

from dataclasses import replace

from robot.hardware.config import (
    DynamixelConfig,
    EmulatedConfig,
    EmulatedDynamixelConfig,
    FeetechConfig,
    IdealConfig,
)
from tests.helpers.robots import nominal_calibration, so101

CALIBRATION = nominal_calibration()
SERVOS = tuple(joint.joint for joint in CALIBRATION.joints)
POSE = {"elbow_flex": 0.4}


def test_an_arm_with_servos_has_the_joints_of_its_calibration_and_an_ideal_one_all_that_move() -> None:
    robot = so101()
    assert FeetechConfig(CALIBRATION, "/dev/arm").joint_names(robot) == SERVOS
    assert EmulatedConfig(CALIBRATION).joint_names(robot) == SERVOS
    assert DynamixelConfig(CALIBRATION, "/dev/arm").joint_names(robot) == SERVOS
    assert EmulatedDynamixelConfig(CALIBRATION).joint_names(robot) == SERVOS
    assert IdealConfig().joint_names(robot) == tuple(joint.name for joint in robot.movable_joints)


def test_simulated_joints_resume_where_they_were_left_and_real_ones_stay_by_themselves() -> None:
    feetech, dynamixel = EmulatedConfig(CALIBRATION, drop=0.1), EmulatedDynamixelConfig(CALIBRATION, drop=0.1)
    assert feetech.resumed(POSE, driven=True) == replace(feetech, start_rad=POSE, driven=True, resumes=True)
    assert dynamixel.resumed(POSE, driven=True) == replace(dynamixel, start_rad=POSE, driven=True)
    assert IdealConfig(0.2).resumed(POSE, driven=False) == IdealConfig(0.2, start_rad=POSE, driven=False)
    for real in (FeetechConfig(CALIBRATION, "/dev/arm"), DynamixelConfig(CALIBRATION, "/dev/arm")):
        assert real.resumed(POSE, driven=True) == real
