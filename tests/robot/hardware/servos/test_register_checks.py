from __future__ import annotations

from typing import Any

import pytest

from robot.faults import Fault
from robot.hardware.servos.family import Limit
from robot.hardware.servos.hardware import CYCLES_BETWEEN, RegisterChecks
from tests.helpers.servo_families import IDS, Family


class Checked:
    """Checks of servos that were surveyed and driven, and the values of their registers as written."""

    def __init__(self, family: Family) -> None:
        hardware = family.in_use().hardware
        self.limits: dict[int, Limit] = hardware._torque.full_limits()
        self.checks = RegisterChecks(family.driver, hardware.servos, hardware._found)
        self.checks.expect(self.limits)
        self.family = family
        watchdog = family.driver.watchdog
        self.as_written: dict[Any, int] = {self.register("TORQUE_ENABLE"): 1}
        if watchdog is None:
            self.as_written[self.limits[2].register] = self.limits[2].value
        else:
            self.as_written[watchdog.register] = watchdog.armed
        # As after power-up.
        self.restarted = {**self.as_written, **({self.limits[2].register: 1000} if watchdog is None else {})}
        if watchdog is not None:
            self.restarted[watchdog.register] = 0

    def register(self, name: str) -> Any:
        return self.family.registers.Register[name]

    def check(self, values: dict[Any, int], servo: int = 2) -> Fault | None:
        return self.checks.check(servo, values, 5.0)


@pytest.fixture
def checked(family: Family) -> Checked:
    return Checked(family)


def test_every_block_of_every_servo_has_its_turn(family: Family, checked: Checked) -> None:
    turns = len(IDS) * len(family.driver.read_back)
    due = [checked.checks.due() for _ in range(turns * CYCLES_BETWEEN)]
    asked = [each for each in due if each is not None]
    assert len(asked) == turns
    assert set(asked) == {(servo, block) for servo in IDS for block in family.driver.read_back}


def test_only_changed_torque_limits_are_written_and_once(checked: Checked) -> None:
    register, value = checked.limits[6]
    wanted = {**checked.limits, 6: Limit(register, value // 2)}
    assert checked.checks.limits_to_write(checked.limits) == {}
    assert checked.checks.limits_to_write(wanted) == {6: wanted[6]}
    assert checked.checks.limits_to_write(wanted) == {}
    # A servo that has lost it gets it again.
    assert checked.checks.check(6, {register: value // 3}, 0.0) is None
    assert checked.checks.limits_to_write(wanted) == {6: wanted[6]}
