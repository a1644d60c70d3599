"""What the supervisor's tests do not show: the causes that keep a fault from being reset."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from robot.faults import Fault, FaultCode
from robot.guard_limits import GuardLimits
from robot.messages import Mode, Order
from robot.servos.registers import Register, StatusBit, Telemetry
from tests.helpers.arm_rig import ArmRig
from tests.robot.conftest import RunningEmulator


@pytest.fixture
def rig(emulator: RunningEmulator) -> Iterator[ArmRig]:
    made = ArmRig(emulator.port, start_enabled=False)
    made.until_mode(Mode.RELAXED)
    yield made
    made.close()


def test_the_guards_bear_what_is_configured(emulator: RunningEmulator) -> None:
    rig = ArmRig(emulator.port, guard_limits=GuardLimits(min_voltage_v=9.0, torque_limit=0.4))
    try:
        rig.until_mode(Mode.FAULT)
        fault = rig.supervisor.fault
        assert fault is not None
        assert "it needs 9 V at least" in fault.message
        assert rig.bus is not None
        assert rig.bus.read(1, Register.TORQUE_LIMIT) == 400
    finally:
        rig.close()


@pytest.mark.parametrize(
    ("code", "temperature_c", "resets"),
    [(FaultCode.OVERHEATED, 54, True), (FaultCode.OVERHEATED, 57, False), (FaultCode.STALLED, 57, True)],
)
def test_a_hot_arm_must_cool_down_before_its_fault_is_reset(
    rig: ArmRig, monkeypatch: pytest.MonkeyPatch, code: FaultCode, temperature_c: int, resets: bool
) -> None:
    arm = rig.supervisor.arm
    assert arm is not None
    assert arm.driver is not None
    arm.driver.latch(Fault(code, "it is hot"))
    real = arm.watch.reading

    def warm(servo_id: int) -> Telemetry:
        return replace(real(servo_id), temperature_c=temperature_c)

    monkeypatch.setattr(arm.watch, "reading", warm)
    answer = rig.order(Order.RESET_FAULT)
    assert answer.done is resets
    assert str(temperature_c) in answer.message or resets


def test_a_servo_that_still_complains_keeps_the_fault(rig: ArmRig, monkeypatch: pytest.MonkeyPatch) -> None:
    arm = rig.supervisor.arm
    assert arm is not None
    assert arm.driver is not None
    arm.driver.latch(Fault(FaultCode.ENCODER_ERROR, "the encoder"))
    monkeypatch.setattr(arm.watch, "status", lambda _servo: int(StatusBit.ENCODER))
    answer = rig.order(Order.RESET_FAULT)
    assert not answer.done
    assert "encoder" in answer.message


def test_an_emergency_stop_of_an_arm_that_is_silent_is_answered(rig: ArmRig, emulator: RunningEmulator) -> None:
    emulator.command(offline=list(rig.supervisor.servos.ids))
    rig.run(0.2)
    answer = rig.order(Order.EMERGENCY_STOP)
    assert not answer.done
    assert "could not be verified at shoulder_pan" in answer.message


def test_without_a_fault_there_is_nothing_to_reset(rig: ArmRig) -> None:
    assert rig.order(Order.RESET_FAULT).message == "there is no fault"


def test_an_arm_that_is_enabled_already_is_left_alone(rig: ArmRig) -> None:
    rig.order(Order.ENABLE)
    assert rig.order(Order.ENABLE).message == "the arm is enabled already"
