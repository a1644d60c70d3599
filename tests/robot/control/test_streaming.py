from __future__ import annotations

import numpy as np
import pytest

from robot import model
from robot.control.streaming import SETPOINT_LASTS_S, Streaming
from robot.limits import JointBounds
from robot.messages import Outcome, Stream

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
PERIOD_S = 0.01
NOWHERE = np.zeros(6)


@pytest.fixture
def stream() -> Streaming:
    """A stream of two joints, in another order than the arm's."""
    bounds = JointBounds.of(model.builtin(), NAMES)
    return Streaming(Stream(3, ("wrist_roll", "shoulder_pan")), NAMES, bounds, np.zeros(6))


def run(stream: Streaming, seconds: float, velocity: tuple[float, float] | None = None, rate: float = 1.0) -> None:
    for _ in range(round(seconds / PERIOD_S)):
        if velocity is not None:
            stream.steer(np.array(velocity))
        stream.advance(PERIOD_S, rate, 1.0)


def test_its_joints_take_the_velocities_of_the_setpoints(stream) -> None:
    run(stream, 0.5, (0.4, -0.2))
    assert stream.commanded.velocity_rad_s == pytest.approx([0.4, -0.2])
    assert list(stream.columns) == [4, 0]
    assert stream.end(NOWHERE, NOWHERE, 0.0) is None


def test_without_setpoints_it_comes_to_rest_and_ends(stream) -> None:
    run(stream, 0.5, (0.4, -0.2))
    run(stream, SETPOINT_LASTS_S - PERIOD_S)
    assert stream.commanded.velocity_rad_s == pytest.approx([0.4, -0.2])
    run(stream, 0.5)
    assert stream.commanded.velocity_rad_s == pytest.approx([0.0, 0.0])
    ended = stream.end(NOWHERE, NOWHERE, 0.0)
    assert ended is not None
    assert (ended.motion_id, ended.outcome) == (3, Outcome.STOPPED)
    assert "no setpoint" in ended.message


def test_a_setpoint_that_comes_while_it_brakes_lets_it_go_on(stream) -> None:
    run(stream, 0.5, (1.0, 0.0))
    run(stream, SETPOINT_LASTS_S + 0.05)
    run(stream, 0.5, (1.0, 0.0))
    assert stream.commanded.velocity_rad_s == pytest.approx([1.0, 0.0])


def test_a_stop_ends_it_whatever_setpoints_come(stream) -> None:
    run(stream, 0.5, (0.4, -0.2))
    stream.stop()
    run(stream, 0.5, (0.4, -0.2))
    assert stream.finished
    assert stream.end(NOWHERE, NOWHERE, 0.0).message == "stopped"


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
