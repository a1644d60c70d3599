"""A leader at another machine: what it sends on a slow network."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass

import numpy as np
import pytest

from robot import logs
from robot.messages import ArmState, Mode
from server import cli
from server.publishing_client import PublishedTopic
from server.teleop.leader_client import IN_FLIGHT, LeaderClient, NewestSample
from tests.helpers.held_connection import HeldConnection

TOPIC = "/leader/joint_states"


def positions(connection: HeldConnection) -> list[float]:
    return [message["position"][0] for message in connection.messages]


def reading(position_rad: float) -> ArmState:
    at = np.array([position_rad])
    return ArmState(position_rad, Mode.RELAXED, ("elbow_flex",), position_rad=at, velocity_rad_s=at)


@dataclass
class Publishing:
    server: HeldConnection
    samples: NewestSample

    async def show(self, *positions_rad: float) -> None:
        for position_rad in positions_rad:
            self.samples.put(reading(position_rad))
            for _ in range(5):
                await asyncio.sleep(0)


@pytest.fixture
async def publishing() -> AsyncIterator[Publishing]:
    server, samples = HeldConnection(), NewestSample()
    client = LeaderClient(PublishedTopic("ws://nowhere", TOPIC, "secret-of-sixteen"), samples, lambda _sentence: None)
    await client.announce(server)
    task = asyncio.create_task(client.publish(server))
    yield Publishing(server, samples)
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task


async def test_it_shows_its_token_and_advertises_before_the_first_sample(publishing: Publishing) -> None:
    await publishing.show(0.5)
    assert [each["op"] for each in publishing.server.sent] == ["auth", "advertise", "publish"]
    assert publishing.server.sent[-1]["msg"]["name"] == ["elbow_flex"]
    assert publishing.server.sent[-1]["msg"]["header"]["stamp"] == {"sec": 0, "nanosec": 500_000_000}


async def test_on_a_slow_network_old_samples_are_left_out(publishing: Publishing) -> None:
    await publishing.show(*(float(number) for number in range(50)))
    assert len(positions(publishing.server)) <= IN_FLIGHT + 2
    publishing.server.pings[0].set_result(0.1)
    await publishing.show(100.0)
    # Those that were on their way, at most one that was waited with, and the newest.
    assert positions(publishing.server)[-1] == 100.0
    assert len(positions(publishing.server)) <= IN_FLIGHT + 4


async def test_an_arm_that_is_not_read_publishes_nothing(publishing: Publishing) -> None:
    publishing.samples.put(ArmState(1.0, Mode.DISCONNECTED, ("elbow_flex",)))
    await publishing.show()
    assert positions(publishing.server) == []


def test_a_real_leader_needs_a_calibration(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(logs, "configure", lambda *_arguments: None)
    assert cli.main(["leader", "--serial", "/dev/nothing"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("armbridge: --calibration: without one nobody knows where the joints")
