from __future__ import annotations

import math

import pytest

from robot.control.arm_on_bus import ArmOnBus
from robot.control.health import arm_health, arm_state, disconnected
from robot.control.pacing import Pacer
from robot.faults import Fault, FaultCode
from robot.limits import JointBounds
from robot.messages import Mode
from robot.servos.bus import Bus
from robot.servos.servo_map import ServoMap
from tests.helpers.arm_rig import CALIBRATION, ROBOT

SERVOS = ServoMap(CALIBRATION, JointBounds.of(ROBOT, tuple(joint.joint for joint in CALIBRATION.joints)))


def test_a_disconnected_arm_says_why_and_keeps_its_fault() -> None:
    fault = Fault(FaultCode.EMERGENCY_STOP, "emergency stop")
    state = disconnected(SERVOS, "unplugged", fault)
    assert (state.mode, state.reason, state.fault) == (Mode.DISCONNECTED, "unplugged", fault)


def test_an_arm_that_was_not_read_has_no_positions(bus: Bus) -> None:
    arm = ArmOnBus(bus, SERVOS)
    assert arm_state(arm, Mode.CONNECTED, None, "", ()).position_rad is None
    health = arm_health(arm, Mode.CONNECTED, None, "", "port", Pacer(0.0), real_time=False)
    assert all(math.isnan(servo.position_rad) for servo in health.servos)
    assert all(servo.warnings for servo in health.servos)


def test_an_arm_that_is_not_driven_has_its_positions_for_goals(bus: Bus) -> None:
    arm = ArmOnBus(bus, SERVOS)
    arm.tick()
    state = arm_state(arm, Mode.RELAXED, None, "", ())
    assert state.position_rad is not None
    assert state.goal_rad == pytest.approx(state.position_rad)
    assert state.current_a is not None
