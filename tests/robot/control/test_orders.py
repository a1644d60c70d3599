"""Orders: the causes that keep a fault from being reset; the rest is shown by the supervisor's tests."""

from __future__ import annotations

import pytest

from robot.faults import Fault, FaultCode
from robot.hardware.config import EmulatedConfig
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import StatusFlag
from robot.messages import GuardLimits, Mode, Order
from tests.helpers.arm_rig import CALIBRATION, ArmRig
from tests.helpers.emulator import SteppedEmulator

IDS = [joint.servo_id for joint in CALIBRATION.joints]


@pytest.fixture
def emulator() -> SteppedEmulator:
    return SteppedEmulator(wire_time=False)


def relaxed(emulator: SteppedEmulator, **settings: object) -> ArmRig:
    made = ArmRig(emulator, start_enabled=False, **settings)
    made.until_mode(Mode.RELAXED)
    return made


@pytest.fixture
def rig(emulator: SteppedEmulator) -> ArmRig:
    return relaxed(emulator)


def latch(rig: ArmRig, code: FaultCode) -> None:
    """Have the arm in a fault that it found some time ago."""
    arm = rig.supervisor.arm
    assert arm is not None
    assert arm.controller is not None
    arm.controller.latch(Fault(code, "it was found"))


def test_the_guards_bear_what_is_configured(emulator: SteppedEmulator) -> None:
    rig = ArmRig(emulator, guard_limits=GuardLimits(min_voltage_v=9.0, torque_limit=0.4))
    rig.until_mode(Mode.FAULT)
    fault = rig.supervisor.fault
    assert fault is not None
    assert "it needs 9 V at least" in fault.message
    assert rig.bus.read(1, Register.TORQUE_LIMIT) == 400


@pytest.mark.parametrize(
    ("code", "temperature_c", "resets"),
    [(FaultCode.OVERHEATED, 54, True), (FaultCode.OVERHEATED, 57, False), (FaultCode.STALLED, 57, True)],
)
def test_a_hot_arm_must_cool_down_before_its_fault_is_reset(
    emulator: SteppedEmulator, rig: ArmRig, code: FaultCode, temperature_c: int, resets: bool
) -> None:
    emulator.command(temperature=dict.fromkeys(map(str, IDS), temperature_c))
    rig.run(0.05)
    latch(rig, code)
    answer = rig.order(Order.RESET_FAULT)
    assert answer.done is resets
    assert str(temperature_c) in answer.message or resets


def test_a_servo_that_still_complains_keeps_the_fault(emulator: SteppedEmulator, rig: ArmRig) -> None:
    emulator.command(status={"4": int(StatusFlag.ENCODER)})
    rig.run(0.05)
    latch(rig, FaultCode.ENCODER_ERROR)
    answer = rig.order(Order.RESET_FAULT)
    assert not answer.done
    assert "wrist_flex (id 4) still complains of encoder" in answer.message


def test_an_overload_that_stays_asks_for_a_power_cut(emulator: SteppedEmulator, rig: ArmRig) -> None:
    emulator.command(status={"4": int(StatusFlag.OVERLOAD)})
    rig.run(0.05)
    latch(rig, FaultCode.OVERLOAD)
    assert rig.order(Order.RESET_FAULT).message.endswith("complains of overload: switch the servos' supply off and on")


def test_the_remedy_of_an_overload_of_a_simulated_arm_is_no_power_cut(emulator: SteppedEmulator) -> None:
    rig = relaxed(emulator, hardware=EmulatedConfig(CALIBRATION))
    emulator.command(status={"4": int(StatusFlag.OVERLOAD)})
    rig.run(0.05)
    latch(rig, FaultCode.OVERLOAD)
    assert rig.order(Order.RESET_FAULT).message.endswith("wrist_flex (id 4) still complains of overload")


def test_an_overload_that_torque_off_clears_is_cleared_by_the_reset(emulator: SteppedEmulator, rig: ArmRig) -> None:
    emulator.servo_bus.servos[3].protection._latched = StatusFlag.OVERLOAD
    rig.run(0.1)
    assert rig.bus.read(4, Register.STATUS) == StatusFlag.OVERLOAD
    latch(rig, FaultCode.OVERLOAD)
    assert rig.order(Order.RESET_FAULT).done
    assert rig.bus.read(4, Register.STATUS) == 0
    assert rig.torque() == [0] * 6


def test_an_emergency_stop_of_an_arm_that_is_silent_is_answered(rig: ArmRig, emulator: SteppedEmulator) -> None:
    emulator.command(offline=IDS)
    rig.run(0.2)
    answer = rig.order(Order.EMERGENCY_STOP)
    assert not answer.done
    assert "could not be verified at shoulder_pan" in answer.message


def test_without_a_fault_there_is_nothing_to_reset(rig: ArmRig) -> None:
    assert rig.order(Order.RESET_FAULT).message == "there is no fault"


def test_an_arm_that_is_enabled_already_is_left_alone(rig: ArmRig) -> None:
    rig.order(Order.ENABLE)
    assert rig.order(Order.ENABLE).message == "the arm is enabled already"
