"""A family that was added as ARCHITECTURE.md says is driven like the others."""

import numpy as np
import pytest

from robot.faults import FaultCode
from robot.hardware.interface import StatusFlag, Survey, run_to_end
from robot.hardware.servos.hardware import CYCLES_BETWEEN, ServoHardware
from robot.messages import GuardLimits
from tests.helpers.arm_rig import BOUNDS, CALIBRATION
from tests.helpers.emulator import SteppedClock
from tests.helpers.third_family import FULL_PERCENT, Register, Third, ThirdBus, ThirdServos

IDS = [joint.servo_id for joint in CALIBRATION.joints]
AT_RAD = 0.2


class ThirdArm:
    """An arm of such servos that was surveyed."""

    def __init__(self) -> None:
        self.servos = ThirdServos(CALIBRATION.joints, AT_RAD)
        clock = SteppedClock()
        self.hardware = ServoHardware(
            Third(), ThirdBus(self.servos, clock), CALIBRATION, BOUNDS, GuardLimits(), clock, simulated=True
        )
        self.clock = clock
        self.found: Survey = run_to_end(self.hardware.survey(), clock.advance)

    def enable(self) -> np.ndarray:
        return run_to_end(self.hardware.enable(range(len(IDS))), self.clock.advance)

    def values(self, register: Register) -> list[int]:
        return [self.servos.value(servo, register) for servo in IDS]


@pytest.fixture
def arm() -> ThirdArm:
    return ThirdArm()


def test_it_is_surveyed(arm: ThirdArm) -> None:
    assert not arm.found.driven.any()
    assert arm.found.max_voltage_v == pytest.approx(8.4)
    assert arm.found.bounds.upper_rad == pytest.approx(BOUNDS.upper_rad)


def test_it_is_enabled_where_it_stands_and_moves(arm: ThirdArm) -> None:
    assert arm.enable() == pytest.approx(AT_RAD, abs=0.002)
    assert arm.values(Register.TORQUE_ENABLE) == [1] * 6
    assert arm.values(Register.TORQUE_PERCENT) == [80] * 5 + [50]
    goal_rad = np.array([0.3, -0.2, 0.1, 0.4, -0.5, 0.6])
    arm.hardware.write_goals(goal_rad)
    measured = arm.hardware.read()
    assert measured is not None
    assert measured.position_rad == pytest.approx(goal_rad, abs=0.002)
    assert measured.voltage_v == pytest.approx(7.4)
    assert measured.temperature_c == pytest.approx(30.0)


def test_its_torque_is_lowered_switched_off_and_cut(arm: ThirdArm) -> None:
    arm.enable()
    assert run_to_end(arm.hardware.relax(np.full(6, 0.4)), arm.clock.advance) == []
    assert arm.values(Register.TORQUE_ENABLE) == [0] * 6
    arm.enable()
    next(arm.hardware.cut_torque())
    assert arm.values(Register.TORQUE_ENABLE) == [0] * 6


def test_a_restart_is_noticed_and_an_error_cleared(arm: ThirdArm) -> None:
    arm.enable()
    arm.servos.power_up(3)
    faults = [arm.hardware.check(0.0) for _ in range(len(IDS) * CYCLES_BETWEEN)]
    (fault,) = [fault for fault in faults if fault is not None]
    assert (fault.code, fault.joint) == (FaultCode.SERVO_REBOOTED, "elbow_flex")
    assert arm.servos.value(3, Register.TORQUE_PERCENT) == FULL_PERCENT
    arm.servos.set(4, Register.ERROR, int(StatusFlag.OVERLOAD))
    measured = arm.hardware.read()
    assert measured is not None
    assert measured.status[3] == StatusFlag.OVERLOAD
    run_to_end(arm.hardware.clear_overloads([3], hold=True), arm.clock.advance)
    assert arm.values(Register.ERROR) == [0] * 6
