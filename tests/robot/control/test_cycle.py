from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from robot.control.controller import ArmController
from robot.control.cycle import ControlCycle
from robot.control.guards import Temperatures
from robot.control.pacing import PERIOD_S
from robot.faults import Fault, FaultCode
from robot.hardware.config import IdealConfig
from robot.hardware.ideal import IdealArm
from tests.helpers.arm_rig import BOUNDS, NAMES, guards
from tests.helpers.emulator import SteppedClock

CALLS = ["read", "write_goals", "write_torque_shares", "check"]


class Rig:
    """Cycle on an ideal arm, whose calls are kept."""

    def __init__(self) -> None:
        self.clock = SteppedClock()
        self.arm = IdealArm(IdealConfig(lag_s=0.0, driven=True), NAMES, BOUNDS, self.clock)
        self.calls: list[str] = []
        for name in CALLS:
            setattr(self.arm, name, self._kept(name, getattr(self.arm, name)))
        self.cycle = ControlCycle(self.arm, self.clock)
        self.cycle.controller = ArmController(NAMES, BOUNDS, guards(), np.ones(6), Temperatures())
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
