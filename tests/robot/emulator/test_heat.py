from __future__ import annotations

import pytest

from robot.emulator.plant import AMBIENT_C, TIME_CONSTANT_S, Motor


def run(motor, duration_s, current_a):
    for _ in range(round(duration_s / 0.1)):
        motor.step(0.1, current_a)
    return motor.temperature_c


def test_a_motor_without_current_stays_as_warm_as_the_air_or_cools_to_it():
    assert run(Motor(), 10.0, 0.0) == AMBIENT_C
    hot = Motor(70.0)
    assert AMBIENT_C < run(hot, TIME_CONSTANT_S, 0.0) < 48.0


def test_a_motor_warms_with_the_square_of_its_current_whatever_its_sign():
    one, two, back = (run(Motor(), 1.0, current) - AMBIENT_C for current in (0.5, 1.0, -1.0))
    assert two == pytest.approx(4.0 * one)
    assert two == back > 0.0


def test_a_stalled_motor_is_too_hot_after_a_minute_and_a_resting_arm_never():
    assert run(Motor(), 70.0, 2.4) > 70.0
    assert run(Motor(), 7200.0, 0.2) < 55.0


def test_heat_can_be_hastened():
    assert run(Motor(rate=100.0), 1.0, 1.0) == pytest.approx(run(Motor(), 100.0, 1.0), rel=0.01)
