"""Streams of trajectories on the controller's topic: each takes over from the setpoints of the one before.

Server, supervisor and controller are the real ones, in stepped time; the joints are ideal.
"""

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable
from typing import Any, cast

import numpy as np
import pytest

from robot.trajectory import PERIOD_S, Vector
from server.execution.streams import STREAM_PAUSE_S
from tests.helpers import stage as stage_module
from tests.helpers.clock import SteppedLoop
from tests.helpers.graph import listen
from tests.helpers.messages import time_message
from tests.helpers.stage import ARM_JOINTS, RecordedStage, inline_threads

pytestmark = pytest.mark.stepped_time

TOPIC = "/arm_controller/joint_trajectory"

STREAM_HZ = 30.0
AHEAD_S = 0.1

# Amplitude of each joint [rad], each at its own frequency [rad/s]: up to 0.5 of the velocity limits.
AMPLITUDE_RAD = np.array([0.5, 0.25, 0.3, 0.4, 0.5])
RATE_RAD_S = np.array([1.2, 1.5, 1.4, 1.6, 1.8])

# The arm follows the points later than their times by this at most: planners of the stage take 0.02 s for a check.
LAG_S = 0.04


def sine(at_s: float) -> tuple[Vector, Vector]:
    """Return positions [rad] and velocities [rad/s] of the arm's joints; both are 0 at time 0."""
    phase = RATE_RAD_S * max(at_s, 0.0)
    return AMPLITUDE_RAD * 0.5 * (1.0 - np.cos(phase)), AMPLITUDE_RAD * 0.5 * RATE_RAD_S * np.sin(phase)


def point(positions_rad: Vector, time_s: float = AHEAD_S, **fields: Any) -> dict[str, Any]:
    return {"positions": positions_rad.tolist(), "time_from_start": time_message(time_s), **fields}


class Controller(RecordedStage):
    """Client that publishes trajectories."""

    def publish(self, *points: dict[str, Any], names: tuple[str, ...] = ARM_JOINTS, stamp_s: float = 0.0) -> None:
        """Publish a trajectory, as in a frame that arrives now."""
        message = {"header": {"stamp": time_message(stamp_s)}, "joint_names": list(names), "points": list(points)}
        self.publish_now(TOPIC, "trajectory_msgs/JointTrajectory", message)

    async def stream(self, duration_s: float, points: Callable[[float], list[dict[str, Any]]] | None = None) -> None:
        """Publish at 30 Hz, by default one point of the sine 0.1 s ahead."""
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        for number in range(round(duration_s * STREAM_HZ)):
            await asyncio.sleep(max(began_s + number / STREAM_HZ - loop.time(), 0.0))
            at_s = loop.time() - began_s
            self.publish(*(points(at_s) if points else [point(sine(at_s + AHEAD_S)[0])]))


@pytest.fixture
async def controller(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Controller]:
    inline_threads(monkeypatch)
    async for made in Controller().run():
        yield made


async def test_a_stream_of_points_moves_the_arm_without_a_stop_and_within_a_lag(controller: Controller) -> None:
    await controller.stream(3.0)
    assert controller.refusals == []
    ticks = np.arange(len(controller.velocity_rad_s))
    wanted = np.array([sine((tick + 0.5) * PERIOD_S - LAG_S)[1] for tick in ticks])
    # Where the sine is fast, so is the arm, in each tick.
    fast = np.abs(wanted) > 0.5 * (0.5 * AMPLITUDE_RAD * RATE_RAD_S)
    fast[ticks < 0.5 / PERIOD_S] = False
    share = controller.velocity_rad_s[fast] / wanted[fast]
    assert share.min() > 0.6
    assert share.max() < 1.7
    reached = np.array(controller.arm_rad)
    late = np.array([sine(tick * PERIOD_S)[0] for tick in range(len(reached))]) - reached
    lag_s = np.abs(late)[50:].max(axis=0) / (0.5 * AMPLITUDE_RAD * RATE_RAD_S)
    assert lag_s.max() < LAG_S
    controller.assert_within_limits()


async def test_slow_planners_stop_no_stream(controller: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each check takes longer than the next message takes to come."""
    monkeypatch.setattr(stage_module, "PLANNING_S", 0.06)
    await controller.stream(2.0)
    speed = np.abs(controller.velocity_rad_s[60:180]).max(axis=1)
    assert speed.min() > 0.05
    controller.assert_within_limits()


# The last is a standstill of the server after the stop, which is no pause of the stream.
STOPS = [*((after_s, 0.0) for after_s in np.arange(0.0, 1.0 / STREAM_HZ, 0.012).tolist()), (0.0, 10.0 * STREAM_PAUSE_S)]


@pytest.mark.parametrize(("after_s", "standstill_s"), STOPS)
async def test_a_stop_at_any_moment_ends_the_stream_until_it_pauses(
    controller: Controller, after_s: float, standstill_s: float
) -> None:
    streaming = asyncio.create_task(controller.stream(1.5))
    await asyncio.sleep(0.7 + after_s)
    controller.stage.call("/arm/stop")
    await asyncio.sleep(0.4)
    at_rest = len(controller.arm_rad)
    cast("SteppedLoop", asyncio.get_running_loop()).advance(standstill_s)
    await streaming
    assert (np.array(controller.arm_rad[at_rest:]) == controller.arm_rad[at_rest]).all()
    assert "the arm was stopped: publish nothing on" in controller.refusals[-1]
    await asyncio.sleep(1.1 * STREAM_PAUSE_S)
    controller.publish(point(controller.arm_rad[-1] + 0.1, 1.0))
    await asyncio.sleep(1.5)
    np.testing.assert_allclose(controller.arm_rad[-1], controller.arm_rad[at_rest] + 0.1, atol=1e-6)


async def test_a_stream_stops_before_an_object(controller: Controller, caplog: pytest.LogCaptureFixture) -> None:
    statuses = listen(controller.stage.graph, "/moveit_goal_status")
    controller.add_walls()
    caplog.set_level(logging.INFO)
    await controller.stream(2.0, lambda at_s: [point(np.array([-0.6 * at_s, 0.6, -0.3, 0.0, 0.0]))])
    await asyncio.sleep(0.5)
    touching = [each for each in statuses if "wall" in each["message"]]
    assert len(touching) > 10
    lines = [each.getMessage() for each in caplog.records if "wall" in each.getMessage()]
    assert len(lines) <= 3, lines
    assert controller.arm_rad[-1][0] > -1.0


async def test_a_stream_is_one_line_in_the_log_also_one_whose_every_message_is_refused(
    controller: Controller, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    await controller.stream(1.0)
    await asyncio.sleep(1.0)
    assert [TOPIC in each.getMessage() for each in caplog.records].count(True) == 1
    await controller.stream(0.5, lambda _at_s: [point(np.array([9.0, 0.0, 0.0, 0.0, 0.0]))])
    assert len(controller.refusals) == 15
    assert "beyond its limits" in controller.refusals[-1]
    assert ["beyond its limits" in each.getMessage() for each in caplog.records].count(True) == 1


FAR = np.array([0.5, 0.0, 0.0, 0.0, 0.0])
NEAR = np.array([0.1, 0.1, -0.1, 0.1, 0.0])


async def test_a_point_at_time_0_is_reached_as_fast_as_the_limits_allow(controller: Controller) -> None:
    controller.publish(point(FAR, 0.0))
    await asyncio.sleep(1.0)
    np.testing.assert_allclose(controller.arm_rad[-1], FAR, atol=1e-6)
    controller.assert_within_limits()


@pytest.mark.parametrize("starts_in_s", [0.5, -0.5])
async def test_the_stamp_is_the_time_of_the_trajectorys_start(controller: Controller, starts_in_s: float) -> None:
    """Points of the past are dropped, and the first point to come is reached in its time."""
    controller.publish(point(NEAR, 0.2), point(FAR, 1.5), stamp_s=time.time() + starts_in_s)
    due = round((1.5 + starts_in_s) / PERIOD_S)
    await asyncio.sleep(2.5)
    np.testing.assert_allclose(controller.arm_rad[due + 8], FAR, atol=1e-4)
    assert np.abs(controller.arm_rad[due - 20] - FAR).max() > 1e-3
    assert controller.refusals == []


async def test_what_lies_behind_is_dropped_and_joints_without_a_name_come_to_rest(controller: Controller) -> None:
    controller.publish(point(FAR, 1.0), point(-FAR, 4.0))
    await asyncio.sleep(1.6)
    controller.publish(point(np.array([0.3]), 1.0), point(np.array([0.0]), 2.0), names=("wrist_flex",))
    await asyncio.sleep(3.0)
    velocity = controller.velocity_rad_s[:, 0]
    # It came from 0.5 rad on its way to -0.5 rad, and has stopped for good, without a jump.
    assert 0.0 < controller.arm_rad[-1][0] < 0.5
    assert controller.arm_rad[-1][3] == pytest.approx(0.0, abs=1e-6)
    assert (velocity[-100:] == 0.0).all()
    controller.assert_within_limits()
