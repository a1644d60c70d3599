"""A leader at another machine: what it sends on a slow network."""

import asyncio
from collections.abc import AsyncIterator

import numpy as np
import pytest

from robot import logs
from robot.messages import ArmState, Mode
from server import cli
from server.publishing_client import PublishedTopic
from server.teleop.leader_client import IN_FLIGHT, LeaderClient
from tests.helpers.held_connection import HeldConnection

TOPIC = "/leader/joint_states"


def reading(position_rad: float) -> ArmState:
    at = np.array([position_rad])
    return ArmState(position_rad, Mode.RELAXED, ("elbow_flex",), position_rad=at, velocity_rad_s=at)


class Publishing:
    """A client that publishes the samples that a test shows, on a connection whose pongs the test gives."""

    def __init__(self) -> None:
        self.server, self.told = HeldConnection(), list[str]()
        self.client = LeaderClient(PublishedTopic("ws://nowhere", TOPIC, "secret-of-sixteen"), self.told.append)

    async def show(self, *states: ArmState) -> None:
        for state in states:
            self.client.take_state(state)
            for _ in range(5):
                await asyncio.sleep(0)

    @property
    def positions(self) -> list[float]:
        return [message["position"][0] for message in self.server.messages]


@pytest.fixture
async def publishing() -> AsyncIterator[Publishing]:
    made = Publishing()
    await made.client.announce(made.server)
    task = asyncio.create_task(made.client.publish(made.server))
    yield made
    task.cancel()
    await asyncio.wait([task])


async def test_it_shows_its_token_and_advertises_before_the_first_sample(publishing: Publishing) -> None:
    await publishing.show(*2 * [ArmState(1.0, Mode.DISCONNECTED, ("elbow_flex",), reason="unplugged")])
    assert (publishing.positions, publishing.told) == ([], ["the arm: unplugged"]), "of an arm that is not read"
    await publishing.show(reading(0.5))
    assert [each["op"] for each in publishing.server.sent] == ["auth", "advertise", "publish"]
    assert publishing.server.sent[-1]["msg"]["name"] == ["elbow_flex"]
    assert publishing.server.sent[-1]["msg"]["header"]["stamp"] == {"sec": 0, "nanosec": 500_000_000}


async def test_on_a_slow_network_old_samples_are_left_out(publishing: Publishing) -> None:
    await publishing.show(*(reading(number) for number in range(50)))
    assert len(publishing.positions) <= IN_FLIGHT + 2
    publishing.server.pings[0].set_result(0.1)
    await publishing.show(reading(100.0))
    # Those that were on their way, at most one that was waited with, and the newest.
    assert publishing.positions[-1] == 100.0
    assert len(publishing.positions) <= IN_FLIGHT + 4


def test_a_real_leader_needs_a_calibration(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(logs, "configure", lambda *_arguments: None)
    assert cli.main(["leader", "--serial", "/dev/nothing"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("armbridge: --calibration: without one nobody knows where the joints")
