from __future__ import annotations

import pytest

from robot.faults import FaultCode
from robot.hardware.feetech.register_checks import CYCLES_BETWEEN, RegisterChecks
from robot.hardware.feetech.registers import Control
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.feetech.survey import ServoFound
from robot.hardware.feetech.torque import full_torque
from robot.limits import JointBounds
from tests.helpers.arm_rig import CALIBRATION, ROBOT

SERVOS = ServoMap(CALIBRATION, JointBounds.of(ROBOT, tuple(joint.joint for joint in CALIBRATION.joints)))
WELL = Control(True, 254, 2048, 800)


@pytest.fixture
def checks() -> RegisterChecks:
    made = RegisterChecks(SERVOS, {servo: ServoFound(WELL, (0, 4095), 8.0, 1000) for servo in SERVOS.ids})
    made.told(full_torque(SERVOS))
    return made


def test_every_servo_has_its_turn_within_a_second(checks: RegisterChecks) -> None:
    turns = [servo for _ in range(100) if (servo := checks.due()) is not None]
    assert set(turns) == set(SERVOS.ids)
    assert len(turns) == 100 // CYCLES_BETWEEN


def test_a_servo_that_is_as_it_was_told_is_well(checks: RegisterChecks) -> None:
    assert checks.judge(1, WELL, 0.0) is None
    assert checks.torque_on[1]


@pytest.mark.parametrize(
    ("control", "code"),
    [
        (Control(False, 254, 2048, 800), FaultCode.TORQUE_LOST),
        (Control(False, 0, 0, 1000), FaultCode.SERVO_REBOOTED),
        (Control(True, 254, 2048, 1000), FaultCode.SERVO_REBOOTED),
    ],
    ids=["relaxed", "rebooted relaxed", "rebooted driven"],
)
def test_a_servo_that_is_not_as_it_was_told_is_a_fault(
    checks: RegisterChecks, control: Control, code: FaultCode
) -> None:
    fault = checks.judge(2, control, 5.0)
    assert fault is not None
    assert (fault.code, fault.joint, fault.stamp_s) == (code, "shoulder_lift", 5.0)


def test_torque_limits_are_written_once_and_again_when_they_were_lost(checks: RegisterChecks) -> None:
    wanted = {**full_torque(SERVOS), 6: 250}
    assert checks.limits_to_write(wanted) == {6: 250}
    assert checks.limits_to_write(wanted) == {}
    assert checks.judge(6, Control(True, 254, 2048, 500), 0.0) is None
    assert checks.limits_to_write(wanted) == {6: 250}
