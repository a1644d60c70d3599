from __future__ import annotations

import numpy as np
import pytest

from robot.control.actuator_thresholds import MARGIN, ActuatorThresholds
from robot.hardware.interface import Actuation
from robot.messages import GuardLimits

LIMITS = GuardLimits()
FULL = np.array([0.8, 0.5])


def unprotected(joints: int) -> Actuation:
    return Actuation.unprotected(np.full(joints, 5.5), np.full(joints, 0.46))


def assumed(**settings: float) -> ActuatorThresholds:
    """ActuatorThresholds about two equal actuators that are as the factory's but for the named settings."""
    usual = {
        "stiffness": 1.0,
        "max_torque": 1.0,
        "overload_torque": 0.8,
        "overload_time_s": 2.0,
        "overload_current_a": 3.25,
        "stall_current_a": 2.7,
        "free_speed_rad_s": 5.5,
        "jump_rad": 0.46,
    }
    return ActuatorThresholds.of(
        LIMITS, Actuation(**{name: np.full(2, value) for name, value in (usual | settings).items()}), FULL
    )


def test_servos_of_the_factory_and_actuators_without_protection_are_taken_as_the_limits_say() -> None:
    for made in (assumed(), ActuatorThresholds.of(LIMITS, unprotected(2), FULL)):
        assert made.goal_tolerance_rad == pytest.approx(LIMITS.goal_tolerance_rad)
        assert made.sustained_torque == pytest.approx(FULL)
        assert np.isinf(made.relieve_after_s).all()
        assert made.stall_current_a == pytest.approx(LIMITS.stall_current_a)
        assert made.stall_time_s == pytest.approx(LIMITS.stall_time_s)


def test_a_joint_with_half_the_gain_may_droop_twice_as_far() -> None:
    backlash_rad = LIMITS.goal_tolerance_rad / 3.0
    droop_rad = LIMITS.goal_tolerance_rad - backlash_rad
    assert assumed(stiffness=0.5).goal_tolerance_rad == pytest.approx(backlash_rad + 2.0 * droop_rad)


@pytest.mark.parametrize("stiffness", [0.0, 0.01, 0.2, 2.0, 8.0])
def test_no_gain_makes_the_tolerance_smaller_than_backlash_and_droop_or_boundless(stiffness: float) -> None:
    tolerance = assumed(stiffness=stiffness).goal_tolerance_rad
    assert (tolerance >= LIMITS.goal_tolerance_rad - 1e-9).all()
    assert (tolerance <= 0.3).all()


def test_a_joint_holds_with_less_than_its_overload_protection_begins_at() -> None:
    made = assumed(overload_torque=0.25)
    assert made.sustained_torque == pytest.approx(MARGIN * 0.25)
    assert (made.relieve_after_s < 2.0).all()


def test_a_joint_holds_with_less_current_than_its_protection_permits() -> None:
    made = assumed(overload_current_a=0.27)
    assert made.sustained_torque == pytest.approx(MARGIN * 0.1)
    assert made.stall_current_a == pytest.approx(MARGIN * 0.27)


def test_a_quick_protection_makes_stalls_be_told_sooner() -> None:
    made = assumed(overload_time_s=0.4, overload_torque=0.25)
    assert made.stall_time_s == pytest.approx(0.1)
    assert (made.stall_time_s < made.relieve_after_s).all()
    assert (made.relieve_after_s < 0.4).all()
