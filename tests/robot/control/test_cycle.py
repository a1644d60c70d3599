from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from robot.control.controller import ArmController
from robot.control.cycle import ControlCycle, ErrorCounts
from robot.faults import Fault, FaultCode
from robot.hardware.config import IdealConfig
from robot.hardware.feetech.registers import Register
from robot.hardware.ideal import IdealArm
from robot.hardware.interface import StatusFlag
from robot.trajectory import PERIOD_S
from tests.helpers.arm_rig import BOUNDS, NAMES, ArmRig, guards, reading
from tests.helpers.emulator import SteppedClock

CALLS = ["read", "write_goals", "write_torque_shares", "check"]
ELBOW = NAMES.index("elbow_flex")


class Rig:
    """Cycle on an ideal arm, whose calls are kept."""

    def __init__(self) -> None:
        self.clock = SteppedClock()
        self.arm = IdealArm(IdealConfig(lag_s=0.0, driven=True), NAMES, BOUNDS, self.clock)
        self.calls: list[str] = []
        for name in CALLS:
            setattr(self.arm, name, self._kept(name, getattr(self.arm, name)))
        self.cycle = ControlCycle(self.arm, self.clock)
        self.cycle.controller = ArmController(NAMES, BOUNDS, guards(), np.ones(6))
        self.tick()

    def _kept(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            self.calls.append(name)
            return method(*arguments)

        return call

    def tick(self) -> list[str]:
        self.calls.clear()
        self.clock.advance(PERIOD_S)
        self.cycle.tick()
        return self.calls


def test_a_cycle_reads_then_writes_then_checks_and_writes_nothing_while_a_sequence_does() -> None:
    rig = Rig()
    assert rig.tick() == ["read", "check"]
    rig.cycle.hold(np.zeros(6))
    assert rig.tick() == CALLS
    with suppress(LookupError), rig.cycle.writing_paused():
        assert rig.tick() == ["read", "check"]
        raise LookupError
    assert rig.tick() == CALLS


def test_what_the_check_finds_of_a_relaxed_arm_is_no_fault() -> None:
    rig = Rig()
    rig.arm.check = lambda stamp_s: Fault(FaultCode.TORQUE_LOST, "it was found relaxed")  # type: ignore[method-assign]
    rig.tick()
    assert rig.cycle.controller.fault is None


def test_a_flag_counts_each_time_it_comes_up_and_not_while_it_stays() -> None:
    counts = ErrorCounts(NAMES)
    both = StatusFlag.OVERLOAD | StatusFlag.VOLTAGE
    for status in (both, StatusFlag.OVERLOAD, both, both, 0, StatusFlag.OVERLOAD):
        counts.observe(reading(np.zeros(6), status=[0, 0, int(status), 0, 0, 0]))
    assert (counts.of(ELBOW), counts.of(0)) == ({"overload": 2, "voltage": 2}, {})


def test_a_finding_that_repeats_is_one_error_until_it_has_gone_and_a_reboot_is_no_lost_torque_as_well() -> None:
    rebooted, relaxed = (Fault(code, "", "elbow_flex") for code in (FaultCode.SERVO_REBOOTED, FaultCode.TORQUE_LOST))
    counts = ErrorCounts(NAMES)
    # It repeats within 5 s.
    for now_s in (1.0, 2.0, 7.0, 12.001, 30.0):
        counts.add_finding(relaxed, now_s)
    assert counts.of(ELBOW) == {"torque_lost": 3}
    counts = ErrorCounts(NAMES)
    for now_s, fault in ((1.0, rebooted), (2.0, relaxed)):
        counts.add_finding(fault, now_s)
    assert counts.of(ELBOW) == {"servo_rebooted": 1}


def errors(rig: ArmRig) -> list[dict[str, int]]:
    """Errors in the next report."""
    rig.run(1.5)
    return [dict(joint.errors) for joint in rig.health.joints if joint.errors]


def test_the_arm_s_report_has_the_errors_of_each_joint_until_the_hardware_is_opened_again() -> None:
    rig = ArmRig()
    rig.run(1.5)
    rig.emulator.command(status={"3": int(StatusFlag.OVERLOAD)})
    assert errors(rig) == [{"overload": 1}]
    rig.emulator.command(status={"3": 0})
    rig.connect()
    assert errors(rig) == []


def test_torque_that_something_else_switched_off_is_in_the_report_once() -> None:
    rig = ArmRig().started()
    rig.bus.write(3, Register.TORQUE_ENABLE, 0)
    rig.run(2.5)
    assert errors(rig) == [{"torque_lost": 1}]
