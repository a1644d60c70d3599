from __future__ import annotations

import math

import pytest

from robot.control.cycle import ControlCycle
from robot.control.health import arm_health, arm_state, disconnected
from robot.control.pacing import Pacer
from robot.faults import Fault, FaultCode
from robot.hardware.clock import SimulationClock
from robot.hardware.config import IdealConfig
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.hardware import FeetechHardware
from robot.messages import ArmHealth, GuardLimits, Mode
from tests.helpers.arm_rig import BOUNDS, CALIBRATION, NAMES, ArmRig
from tests.helpers.stepped_emulator import SteppedEmulator


@pytest.fixture
def arm(emulator: SteppedEmulator, bus: Bus) -> ControlCycle:
    return ControlCycle(FeetechHardware(bus, CALIBRATION, BOUNDS, GuardLimits(), emulator.clock), emulator.clock)


def test_a_disconnected_arm_has_a_reason_and_keeps_its_fault() -> None:
    fault = Fault(FaultCode.EMERGENCY_STOP, "emergency stop")
    state = disconnected(NAMES, "unplugged", fault, 12.5)
    assert (state.mode, state.reason, state.fault) == (Mode.DISCONNECTED, "unplugged", fault)
    assert (state.joint_names, state.clock_s) == (NAMES, 12.5)


def test_an_arm_that_was_not_read_has_no_positions(arm: ControlCycle, emulator: SteppedEmulator) -> None:
    state = arm_state(arm, Mode.CONNECTED, None, "", (), emulator.clock())
    assert state.position_rad is None
    health = arm_health(arm, state, "port", Pacer(0.0), emulator.clock, real_time=False)
    assert all(math.isnan(joint.position_rad) for joint in health.joints)
    assert all(joint.warnings for joint in health.joints)


def test_an_arm_that_is_not_driven_has_its_positions_for_goals(arm: ControlCycle) -> None:
    arm.tick()
    state = arm_state(arm, Mode.RELAXED, None, "", (), 7.0)
    assert state.position_rad is not None
    assert state.goal_rad == pytest.approx(state.position_rad)
    assert state.current_a is not None
    assert (state.clock_s, state.driven) == (7.0, False)


def test_the_real_time_factor_is_that_of_the_loops_clock(arm: ControlCycle) -> None:
    clock = SimulationClock(0.0)
    clock.start_tick(0.04)
    state = arm_state(arm, Mode.CONNECTED, None, "", (), clock())
    health = arm_health(arm, state, "port", Pacer(0.0), clock, real_time=False)
    assert health.real_time_factor == pytest.approx(0.5)


def ideal_health() -> ArmHealth:
    rig = ArmRig(hardware=IdealConfig())
    rig.run(1.5)
    return rig.health


def test_hardware_without_a_bus_has_no_counters_of_one() -> None:
    assert ideal_health().bus is None


def test_what_the_hardware_does_not_measure_is_not_a_number() -> None:
    for joint in ideal_health().joints:
        assert math.isnan(joint.temperature_c)
        assert math.isnan(joint.voltage_v)
        assert math.isnan(joint.current_a)
        assert math.isfinite(joint.position_rad)
        assert joint.warnings == ()
