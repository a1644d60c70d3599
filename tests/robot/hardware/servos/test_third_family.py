"""A family that was added as ARCHITECTURE.md says is driven like the others."""

from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from robot.description.servo_table import MAX_HOMING_OFFSET, ServoKind
from robot.faults import FaultCode
from robot.hardware.interface import StatusFlag, run_to_end
from robot.hardware.servos.family import ServoFamily
from robot.hardware.servos.hardware import CYCLES_BETWEEN, ServoHardware, family_of
from robot.messages import GuardLimits
from tests.helpers.arm_rig import BOUNDS, CALIBRATION, ServosInUse
from tests.helpers.emulator import SteppedClock
from tests.helpers.third_family import FULL_PERCENT, Register, Third, ThirdBus, ThirdServos

IDS = [joint.servo_id for joint in CALIBRATION.joints]
AT_RAD = 0.2


class ThirdArm(ServosInUse):
    """An arm with servos of the third family."""

    def __init__(self) -> None:
        clock = SteppedClock()
        self.servos = ThirdServos(CALIBRATION.joints, AT_RAD)
        settings = CALIBRATION, BOUNDS, GuardLimits(), clock
        hardware = ServoHardware(Third(), ThirdBus(self.servos, clock), *settings, simulated=True)
        super().__init__(SimpleNamespace(run=clock.advance), hardware)

    def values(self, register: Register) -> list[int]:
        return [self.servos.value(servo, register) for servo in IDS]


def test_it_is_surveyed_enabled_where_it_stands_moves_and_is_relaxed_or_cut() -> None:
    arm = ThirdArm()
    assert not arm.found.driven.any()
    assert arm.found.max_voltage_v == pytest.approx(8.4)
    assert arm.found.bounds.upper_rad == pytest.approx(BOUNDS.upper_rad)
    assert arm.enable() == pytest.approx(AT_RAD, abs=0.002)
    assert arm.values(Register.TORQUE_ENABLE) == [1] * 6
    assert arm.values(Register.TORQUE_PERCENT) == [80] * 5 + [50]
    goal_rad = np.array([0.3, -0.2, 0.1, 0.4, -0.5, 0.6])
    arm.hardware.write_goals(goal_rad)
    measured = arm.read()
    assert measured.position_rad == pytest.approx(goal_rad, abs=0.002)
    assert measured.voltage_v == pytest.approx(7.4)
    assert measured.temperature_c == pytest.approx(30.0)
    assert run_to_end(arm.hardware.relax(np.full(6, 0.4)), arm.emulator.run) == []
    assert arm.values(Register.TORQUE_ENABLE) == [0] * 6
    arm.enable()
    next(arm.hardware.cut_torque())
    assert arm.values(Register.TORQUE_ENABLE) == [0] * 6


def test_a_restart_is_noticed_and_an_error_cleared() -> None:
    arm = ThirdArm()
    arm.enable()
    arm.servos.power_up(3)
    faults = [arm.hardware.check(0.0) for _ in range(len(IDS) * CYCLES_BETWEEN)]
    (fault,) = [fault for fault in faults if fault is not None]
    assert (fault.code, fault.joint) == (FaultCode.SERVO_REBOOTED, "elbow_flex")
    assert arm.servos.value(3, Register.TORQUE_PERCENT) == FULL_PERCENT
    arm.servos.set(4, Register.ERROR, int(StatusFlag.OVERLOAD))
    assert arm.read().status[3] == StatusFlag.OVERLOAD
    run_to_end(arm.hardware.clear_overloads([3], hold=True), arm.emulator.run)
    assert arm.values(Register.ERROR) == [0] * 6


@pytest.mark.parametrize("kind", get_args(ServoKind))
def test_each_kind_of_servos_has_a_family_and_a_greatest_homing_offset(kind: ServoKind) -> None:
    assert isinstance(family_of(kind), ServoFamily)
    assert MAX_HOMING_OFFSET[kind] > 0
