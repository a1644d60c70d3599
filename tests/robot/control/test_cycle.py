from __future__ import annotations

import numpy as np
import pytest

from robot.control.controller import ArmController
from robot.control.cycle import ControlCycle
from robot.control.guards import Temperatures
from robot.control.pacing import PERIOD_S
from robot.faults import Fault, FaultCode
from robot.hardware.config import IdealConfig
from robot.hardware.ideal import IdealArm
from robot.hardware.interface import Measured
from robot.messages import MotionEnded
from robot.trajectory import Vector
from tests.helpers.arm_rig import BOUNDS, NAMES, guards
from tests.helpers.emulator import SteppedClock


class RecordedArm(IdealArm):
    """An ideal arm that keeps what was asked of it, and finds the fault that a test gives it."""

    def __init__(self, clock: SteppedClock) -> None:
        super().__init__(IdealConfig(lag_s=0.0, driven=True), NAMES, BOUNDS, clock)
        self.calls: list[str] = []
        self.goals: list[Vector] = []
        self.heard = True
        self.found: Fault | None = None

    def read(self) -> Measured | None:
        self.calls.append("read")
        return super().read() if self.heard else None

    def write_goals(self, goal_rad: Vector) -> None:
        self.calls.append("goals")
        self.goals.append(goal_rad)
        super().write_goals(goal_rad)

    def write_torque_shares(self, torque_share: Vector) -> None:
        self.calls.append("shares")

    def check(self, stamp_s: float) -> Fault | None:
        self.calls.append("check")
        return self.found


class CycleRig:
    """A cycle on that arm, and its clock."""

    def __init__(self) -> None:
        self.clock = SteppedClock()
        self.hardware = RecordedArm(self.clock)
        self.cycle = ControlCycle(self.hardware, self.clock)

    def control(self) -> ArmController:
        """Let a controller decide, which does not drive yet."""
        self.cycle.controller = ArmController(NAMES, BOUNDS, guards(), np.ones(6), Temperatures())
        return self.cycle.controller

    def tick(self) -> list[MotionEnded]:
        self.hardware.calls.clear()
        self.clock.advance(PERIOD_S)
        return self.cycle.tick()


@pytest.fixture
def rig() -> CycleRig:
    return CycleRig()


@pytest.fixture
def holding(rig: CycleRig) -> CycleRig:
    rig.control()
    rig.tick()
    rig.cycle.hold(np.zeros(6))
    return rig


def test_a_cycle_reads_then_writes_then_checks(holding: CycleRig) -> None:
    holding.tick()
    assert holding.hardware.calls == ["read", "goals", "shares", "check"]


def test_ticks_write_no_goals_while_a_sequence_writes_its_own(holding: CycleRig) -> None:
    with holding.cycle.writing_paused():
        holding.tick()
        assert holding.hardware.calls == ["read", "check"]
    holding.tick()
    assert holding.hardware.calls == ["read", "goals", "shares", "check"]


def test_goals_are_written_again_after_a_sequence_that_failed(holding: CycleRig) -> None:
    with pytest.raises(LookupError), holding.cycle.writing_paused():
        raise LookupError
    holding.tick()
    assert "goals" in holding.hardware.calls


def test_what_the_check_finds_of_a_relaxed_arm_is_no_fault(rig: CycleRig) -> None:
    controller = rig.control()
    rig.hardware.found = Fault(FaultCode.TORQUE_LOST, "it was found relaxed")
    rig.tick()
    assert controller.fault is None
