from __future__ import annotations

from dataclasses import replace

import pytest

from robot.calibration import Calibration
from robot.description.limits import END_STOP_MARGIN_RAD, FASTEST_TICKS_S, within_calibration
from robot.errors import DescriptionError
from tests.helpers.robots import nominal_calibration, so101


def test_an_ideal_arm_reaches_the_limits_of_the_urdf() -> None:
    robot = so101()
    narrowed = within_calibration(robot, nominal_calibration())
    for name in robot.groups["arm"].joints:
        assert narrowed.joints[name] == robot.joints[name]


def test_limits_never_exceed_the_urdf_nor_the_calibrated_range_less_the_margin() -> None:
    robot, calibration = so101(), nominal_calibration()
    short = replace(calibration.joints[1], range_min=1500, range_max=2500)
    calibration = Calibration((calibration.joints[0], short, *calibration.joints[2:]))
    joint = within_calibration(robot, calibration).joints["shoulder_lift"]
    assert joint.lower == pytest.approx(short.lower_rad + END_STOP_MARGIN_RAD)
    assert joint.upper == pytest.approx(short.upper_rad - END_STOP_MARGIN_RAD)


def test_a_velocity_limit_above_what_a_servo_follows_is_narrowed_with_one_line_of_the_log(
    caplog: pytest.LogCaptureFixture,
) -> None:
    robot = so101()
    joints = {**robot.joints, "wrist_flex": replace(robot.joints["wrist_flex"], max_velocity=4.0)}
    narrowed = within_calibration(replace(robot, joints=joints), nominal_calibration())
    servo = nominal_calibration().joints[3]
    assert narrowed.joints["wrist_flex"].max_velocity == pytest.approx(2.51, abs=0.01)
    assert abs(servo.ticks_s_from_rad_s(narrowed.joints["wrist_flex"].max_velocity)) < FASTEST_TICKS_S
    assert [record.message for record in caplog.records] == [
        "joint wrist_flex: its velocity limit of 4 rad/s is narrowed to 2.51 rad/s, the most its servo can follow"
    ]


def test_a_range_of_no_width_is_refused() -> None:
    calibration = nominal_calibration()
    narrow = replace(calibration.joints[0], range_min=2000, range_max=2010)
    with pytest.raises(DescriptionError, match="shoulder_pan"):
        within_calibration(so101(), Calibration((narrow, *calibration.joints[1:])))


def test_a_calibrated_joint_that_the_robot_lacks_is_named() -> None:
    calibration = nominal_calibration()
    first = calibration.joints[0]
    other = replace(first, servo=replace(first.servo, joint="knee"))
    with pytest.raises(DescriptionError, match="knee"):
        within_calibration(so101(), Calibration((other, *calibration.joints[1:])))
