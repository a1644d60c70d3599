from __future__ import annotations

import numpy as np
import pytest

from robot.control.cycle import SAME_ERROR_S, ErrorCounts
from robot.faults import Fault, FaultCode
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import Measured, StatusFlag
from robot.messages import Mode
from tests.helpers.arm_rig import NAMES, ArmRig, reading

HERE = np.zeros(6)
REBOOTED = Fault(FaultCode.SERVO_REBOOTED, "the servo of joint elbow_flex has started anew", "elbow_flex")
RELAXED = Fault(FaultCode.TORQUE_LOST, "the servo of joint elbow_flex was found relaxed", "elbow_flex")
ELBOW = NAMES.index("elbow_flex")


def flagged(status: int) -> Measured:
    return reading(HERE, status=[0, 0, status, 0, 0, 0])


@pytest.fixture
def counts() -> ErrorCounts:
    return ErrorCounts(NAMES)


def test_a_flag_counts_each_time_it_comes_up_and_not_while_it_stays(counts: ErrorCounts) -> None:
    for status in (0, StatusFlag.OVERLOAD, StatusFlag.OVERLOAD, 0, StatusFlag.OVERLOAD):
        counts.observe(flagged(status))
    assert counts.of(ELBOW) == {"overload": 2}
    assert counts.of(0) == {}


def test_a_finding_that_repeats_is_one_error_until_it_has_gone(counts: ErrorCounts) -> None:
    for now_s in (1.0, 2.0, 3.0, 3.0 + 2 * SAME_ERROR_S):
        counts.add_finding(RELAXED, now_s)
    assert counts.of(ELBOW) == {"torque_lost": 2}


def test_a_servo_that_rebooted_is_not_counted_as_relaxed_as_well(counts: ErrorCounts) -> None:
    counts.add_finding(REBOOTED, 1.0)
    counts.add_finding(RELAXED, 2.0)
    assert counts.of(ELBOW) == {"servo_rebooted": 1}


def test_the_arm_s_report_has_the_errors_of_each_joint_until_the_hardware_is_opened_again() -> None:
    rig = ArmRig()
    rig.run(1.5)
    rig.emulator.command(status={"3": int(StatusFlag.OVERLOAD)})
    rig.run(1.5)
    assert [dict(joint.errors) for joint in rig.health.joints if joint.errors] == [{"overload": 1}]
    rig.emulator.command(status={"3": 0})
    rig.connect()
    rig.run(1.5)
    assert not any(joint.errors for joint in rig.health.joints)


def test_torque_that_something_else_switched_off_is_in_the_report_once() -> None:
    rig = ArmRig()
    rig.until_mode(Mode.HOLDING)
    rig.bus.write(3, Register.TORQUE_ENABLE, 0)
    rig.run(4.0)
    assert [dict(joint.errors) for joint in rig.health.joints if joint.errors] == [{"torque_lost": 1}]
