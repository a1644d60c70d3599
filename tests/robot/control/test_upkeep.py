from __future__ import annotations

import pytest

from robot.control.startup import ServoFound
from robot.control.torque import full_torque
from robot.control.upkeep import CYCLES_BETWEEN, Upkeep
from robot.faults import FaultCode
from robot.limits import JointBounds
from robot.servos.control_block import Control
from robot.servos.servo_map import ServoMap
from tests.helpers.arm_rig import CALIBRATION, ROBOT

SERVOS = ServoMap(CALIBRATION, JointBounds.of(ROBOT, tuple(joint.joint for joint in CALIBRATION.joints)))
WELL = Control(True, 254, 2048, 800)


@pytest.fixture
def upkeep() -> Upkeep:
    made = Upkeep(SERVOS, {servo: ServoFound(WELL, (0, 4095), 8.0, 1000, ("old",)) for servo in SERVOS.ids})
    made.told(full_torque(SERVOS))
    return made


def test_every_servo_has_its_turn_within_a_second(upkeep: Upkeep) -> None:
    turns = [servo for _ in range(100) if (servo := upkeep.due()) is not None]
    assert set(turns) == set(SERVOS.ids)
    assert len(turns) == 100 // CYCLES_BETWEEN


def test_a_servo_that_is_as_it_was_told_is_well(upkeep: Upkeep) -> None:
    assert upkeep.judge(1, WELL, 0.0) is None
    assert upkeep.torque_on[1]


@pytest.mark.parametrize(
    ("control", "code"),
    [
        (Control(False, 254, 2048, 800), FaultCode.TORQUE_LOST),
        (Control(False, 0, 0, 1000), FaultCode.SERVO_REBOOTED),
        (Control(True, 254, 2048, 1000), FaultCode.SERVO_REBOOTED),
    ],
    ids=["relaxed", "rebooted relaxed", "rebooted driven"],
)
def test_a_servo_that_is_not_as_it_was_told_is_a_fault(upkeep: Upkeep, control: Control, code: FaultCode) -> None:
    fault = upkeep.judge(2, control, 5.0)
    assert fault is not None
    assert (fault.code, fault.joint, fault.stamp_s) == (code, "shoulder_lift", 5.0)


def test_torque_limits_are_written_once_and_again_when_they_were_lost(upkeep: Upkeep) -> None:
    wanted = {**full_torque(SERVOS), 6: 250}
    assert upkeep.limits_to_write(wanted) == {6: 250}
    assert upkeep.limits_to_write(wanted) == {}
    assert upkeep.judge(6, Control(True, 254, 2048, 500), 0.0) is None
    assert upkeep.limits_to_write(wanted) == {6: 250}


def test_what_was_found_at_the_start_is_kept(upkeep: Upkeep) -> None:
    assert upkeep.warnings(4) == ("old",)
