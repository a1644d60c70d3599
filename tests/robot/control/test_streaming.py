from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot.control.streaming import (
    LEAST_SPEED_RAD_S,
    SETPOINT_LASTS_S,
    Streaming,
    VelocityTracking,
)
from robot.description.limits import JointBounds
from robot.messages import Outcome, Stream
from robot.trajectory import TIME_TO_FULL_ACCELERATION_S
from tests.helpers.arm_rig import NAMES
from tests.helpers.robots import so101

PERIOD_S = 0.01
BOUNDS = JointBounds(np.array([-1.0, -0.5]), np.array([1.0, 0.8]), np.array([2.0, 1.2]), np.array([6.0, 3.0]))
MAX_JERK = BOUNDS.max_acceleration / TIME_TO_FULL_ACCELERATION_S

targets = st.lists(st.tuples(st.tuples(*[st.floats(-3.0, 3.0)] * 2), st.integers(1, 30)), min_size=1, max_size=8)


def follow(steps: list[tuple[tuple[float, float], int]], start: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Positions at every tick, with a rest at the end that is long enough to stop in."""
    tracking = VelocityTracking(BOUNDS, np.array(start))
    positions = [tracking.position_rad]
    for velocity, ticks in [*steps, ((0.0, 0.0), 150)]:
        tracking.set_target(np.array(velocity))
        positions += [tracking.advance(PERIOD_S) for _ in range(ticks)]
    assert tracking.at_rest
    return np.array(positions)


@settings(max_examples=100, deadline=None)
@given(targets)
def test_at_any_target_velocity_acceleration_and_jerk_stay_bounded(steps) -> None:
    positions = follow(steps)
    velocity, acceleration, jerk = (np.diff(positions, n, axis=0) / PERIOD_S**n for n in (1, 2, 3))
    assert (np.abs(velocity) <= BOUNDS.max_velocity + 1e-6).all()
    assert (np.abs(acceleration) <= BOUNDS.max_acceleration + 1e-4).all()
    assert (np.abs(jerk) <= MAX_JERK + 1e-2).all()


@settings(max_examples=100, deadline=None)
@given(targets)
def test_at_any_target_no_joint_leaves_its_limits(steps) -> None:
    positions = follow(steps)
    assert (positions <= BOUNDS.upper_rad + 1e-6).all()
    assert (positions >= BOUNDS.lower_rad - 1e-6).all()


def test_a_joint_at_its_limit_waits_there_while_the_other_goes_on() -> None:
    tracking = VelocityTracking(BOUNDS, np.zeros(2))
    tracking.set_target(np.array([0.3, 1.2]))
    for _ in range(200):
        tracking.advance(PERIOD_S)
    assert tracking.position_rad[1] == pytest.approx(0.8)
    assert tracking.velocity_rad_s == pytest.approx([0.3, 0.0], abs=1e-9)


def test_a_joint_that_stands_outside_its_limits_stays_or_comes_inside() -> None:
    assert follow([((1.0, 0.0), 50)], start=(1.1, 0.0))[:, 0].max() == pytest.approx(1.1)
    assert follow([((-1.0, 0.0), 50)], start=(1.1, 0.0))[-1, 0] < 1.0


def test_a_target_too_slow_to_see_is_rest() -> None:
    assert np.abs(follow([((0.9 * LEAST_SPEED_RAD_S, 0.0), 100)])).max() == 0.0


NOWHERE = np.zeros(6)


@pytest.fixture
def stream() -> Streaming:
    """A stream of two joints, in another order than the arm's."""
    bounds = JointBounds.of(so101(), NAMES)
    return Streaming(Stream(3, ("wrist_roll", "shoulder_pan")), NAMES, bounds, np.zeros(6))


def run(stream: Streaming, seconds: float, velocity: tuple[float, float] | None = None, rate: float = 1.0) -> None:
    for _ in range(round(seconds / PERIOD_S)):
        if velocity is not None:
            stream.steer(np.array(velocity))
        stream.step(PERIOD_S, rate, 1.0)


def test_without_setpoints_it_comes_to_rest_and_ends(stream) -> None:
    run(stream, 0.5, (0.4, -0.2))
    run(stream, SETPOINT_LASTS_S - PERIOD_S)
    assert stream.commanded.velocity_rad_s == pytest.approx([0.4, -0.2])
    run(stream, 0.5)
    assert stream.commanded.velocity_rad_s == pytest.approx([0.0, 0.0])
    ended = stream.end(NOWHERE, NOWHERE, 0.0)
    assert (ended.motion_id, ended.outcome) == (3, Outcome.UNSTEERED)
    assert "no setpoint" in ended.message


def test_a_setpoint_that_comes_while_it_brakes_lets_it_go_on(stream) -> None:
    run(stream, 0.5, (1.0, 0.0))
    run(stream, SETPOINT_LASTS_S + 0.05)
    run(stream, 0.5, (1.0, 0.0))
    assert stream.commanded.velocity_rad_s == pytest.approx([1.0, 0.0])


@pytest.mark.parametrize("bad", [[np.nan, 0.0], [np.inf, 0.0], [0.1], [0.1, 0.1, 0.1]])
def test_a_setpoint_that_is_none_ends_it_smoothly(stream, bad) -> None:
    run(stream, 0.5, (0.4, -0.2))
    stream.steer(np.array(bad))
    assert not stream.finished
    run(stream, 0.5)
    assert "no velocities" in stream.end(NOWHERE, NOWHERE, 0.0).message


@pytest.mark.parametrize(("rate", "share"), [(0.5, 0.5), (0.0, 0.0), (-1.0, 0.0)])
def test_a_slower_pace_slows_it_and_back_is_a_pause(stream, rate, share) -> None:
    run(stream, 0.5, (0.4, -0.2), rate)
    assert stream.commanded.velocity_rad_s == pytest.approx(share * np.array([0.4, -0.2]))
