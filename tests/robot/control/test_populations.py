"""The driver on each population of servos: what it says of them, and what it does."""

from __future__ import annotations

import pytest

from robot.emulator.populations import POPULATIONS
from robot.messages import Mode, Order
from tests.helpers.arm_rig import ArmRig
from tests.helpers.emulator import SteppedEmulator

USABLE = [name for name in POPULATIONS if name not in ("ros2_driver", "kit")]


def rig_on(population: str) -> ArmRig:
    return ArmRig(SteppedEmulator("--population", population, wire_time=False))


@pytest.mark.parametrize("population", USABLE)
def test_an_arm_of_each_population_is_enabled_where_it_stands(population):
    rig = rig_on(population)
    rig.until_mode(Mode.HOLDING)
    before = [servo.plant.position_ticks for servo in rig.emulator.servo_bus.servos]
    rig.run(1.0)
    after = [servo.plant.position_ticks for servo in rig.emulator.servo_bus.servos]
    assert after == pytest.approx(before, abs=30.0)


def test_a_kit_is_no_arm_yet():
    rig = rig_on("kit")
    rig.run(3.0)
    assert rig.mode is not Mode.HOLDING
    assert [servo.value(40) for servo in rig.emulator.servo_bus.servos] == [0] * 6


@pytest.fixture
def latched() -> ArmRig:
    """An arm of clones, whose elbow has been pushed until its overload latched."""
    rig = rig_on("clone")
    rig.until_mode(Mode.HOLDING)
    rig.emulator.command(push={"3": 900})
    rig.until(lambda: rig.fault_code == "overload", 10.0)
    rig.emulator.command(push={"3": 0})
    # The controller tries to relax the arm by itself.
    rig.run(5.0)
    return rig


def test_the_reset_of_an_overload_that_stays_says_to_cut_the_supply(latched):
    answer = latched.order(Order.RESET_FAULT)
    assert not answer.done
    assert "elbow_flex (id 3)" in answer.message
    assert "switch the servos' supply off and on" in answer.message


@pytest.mark.parametrize("order", [Order.RELAX, Order.EMERGENCY_STOP])
def test_torque_that_cannot_be_switched_off_says_to_cut_the_supply(latched, order):
    answer = latched.order(order)
    assert not answer.done
    assert "elbow_flex (id 3): they may still be driven until the servos' supply is cut" in answer.message


def test_a_power_cycle_ends_an_overload_that_stays(latched):
    latched.emulator.command(power_cycle=[1, 2, 3, 4, 5, 6])
    latched.run(1.0)
    answer = latched.order(Order.RESET_FAULT)
    assert answer.done, answer.message
    assert latched.order(Order.ENABLE).done
    assert latched.mode is Mode.HOLDING
