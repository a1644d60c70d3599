"""The gripper of a follower: as near behind its leader as the joints of the arm.

Server, supervisor and controller are the real ones, in stepped time; the joints are ideal.
"""

import asyncio
import math
from collections.abc import AsyncIterator, Callable

import numpy as np
import pytest

from robot.control.pacing import PERIOD_S
from tests.helpers.arm_rig import NAMES
from tests.helpers.messages import time_message
from tests.helpers.stage import RecordedStage, inline_threads

pytestmark = pytest.mark.stepped_time

GRIPPER = NAMES.index("gripper")

# To the leader, and into its rhythm [s].
SETTLED_S = 1.5
LAG_S = 0.1


class Led(RecordedStage):
    """An arm that follows a topic."""

    async def lead(self, seconds: float, gripper_rad: Callable[[float], float]) -> float:
        """Lead by 50 samples a second; returns the last goal of the gripper [rad]."""
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        while (at_s := loop.time() - began_s) < seconds:
            position = [0.1, 0.0, 0.0, 0.0, 0.0, gripper_rad(at_s)]
            sample = {"header": {"stamp": time_message(5.0 + at_s)}, "name": list(NAMES), "position": position}
            self.publish_now("/glove", "sensor_msgs/JointState", sample)
            await asyncio.sleep(2.0 * PERIOD_S)
        return float(self.goals_rad[-1][GRIPPER])


@pytest.fixture
async def led(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Led]:
    inline_threads(monkeypatch)
    async for made in Led().run():
        made.stage.call("/teleop/start", leader="/glove")
        yield made


def opening(at_s: float) -> float:
    """Return the leader's gripper, which opens and closes every 2 s [rad]."""
    return 0.7 - 0.5 * math.cos(2.0 * math.pi * 0.5 * at_s)


async def test_the_gripper_follows_within_a_tenth_of_a_second(led: Led) -> None:
    await led.lead(4.0, opening)
    first = round(SETTLED_S / PERIOD_S)
    goals = np.array(led.goals_rad)[first:, GRIPPER]
    at_s = (np.arange(len(goals)) + first + 1) * PERIOD_S
    behind = np.abs(goals - np.array([opening(each) for each in at_s]))
    # At its fastest the leader goes this far in the time.
    assert behind.max() < LAG_S * 0.5 * 2.0 * math.pi * 0.5
    assert np.ptp(goals) > 0.9


async def test_a_gripper_that_another_client_moved_follows_when_the_leader_moves_on(led: Led) -> None:
    assert await led.lead(2.0, lambda _at_s: 0.5) == pytest.approx(0.5, abs=0.01)
    command = {"position": 1.0}
    led.stage.send("/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand", command=command)
    assert await led.lead(2.0, lambda _at_s: 0.5) == pytest.approx(1.0, abs=0.01)
    assert await led.lead(1.0, lambda _at_s: 0.6) == pytest.approx(0.6, abs=0.01)


async def test_a_stop_stops_the_gripper(led: Led) -> None:
    await led.lead(2.0, lambda at_s: 0.2 + 0.2 * at_s)
    led.stage.call("/arm/stop")
    held_rad = await led.lead(0.3, lambda at_s: 0.6 + 0.2 * at_s)
    assert await led.lead(1.0, lambda at_s: 0.66 + 0.2 * at_s) == held_rad
