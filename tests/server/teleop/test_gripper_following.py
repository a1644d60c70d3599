"""The gripper of a follower: as near behind its leader as the joints of the arm.

Server, supervisor and controller are the real ones, in stepped time; the joints are ideal.
"""

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import numpy as np
import pytest

from protocol.publication import PublishedMessage
from robot.trajectory import PERIOD_S
from server.datasets.export import ExportOptions, export
from server.datasets.samples import LEADER_TOPIC, STATE_TOPIC
from server.graph.permissions import Node
from server.graph.topics import Subscriber
from server.recording.files import RecordedMessage
from tests.helpers.arm_rig import NAMES
from tests.helpers.messages import time_message
from tests.helpers.stage import RecordedStage, inline_threads
from tests.server.recordings import REGISTRY, START_NS, entry, record

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


async def test_a_dataset_has_the_gripper_within_a_tenth_of_a_second_of_its_action(led: Led, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra [datasets] is not installed: no pyarrow")
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    recorded: list[RecordedMessage] = []

    def take(published: PublishedMessage) -> None:
        # The wall clock of stamps is no stepped time: without stamps the time of recording counts.
        message = {**published.msg, "header": {}}
        recorded.append(entry(published.topic, "sensor_msgs/JointState", message, loop.time() - began_s))

    for topic in (STATE_TOPIC, LEADER_TOPIC):
        led.stage.graph.subscribe(Node("recorder"), topic, "sensor_msgs/JointState", Subscriber(take))
    await led.lead(SETTLED_S + 4.0, opening)
    recording = record(tmp_path / "run.mcap", [each for each in recorded if each.log_time_ns > START_NS + 1.5e9])
    done = export(ExportOptions(recording, tmp_path / "data", fps=50), REGISTRY, lambda _text: None)
    assert (done.actions, done.problems) == (LEADER_TOPIC, ())
    rows = parquet.read_table(tmp_path / "data/data/chunk-000/file-000.parquet").to_pylist()
    states, actions = (np.array([row[name] for row in rows])[:, GRIPPER] for name in ("observation.state", "action"))
    assert np.ptp(states) > 0.9
    assert np.abs(states - actions).max() < LAG_S * 0.5 * 2.0 * math.pi * 0.5


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
