"""Servers of several arms, a client that sees goals and joints, and a notifier of systemd."""

from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from harness.clients import FrameClient, frame_client
from harness.server import RunningServer
from tests.helpers.systemd import Systemd


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("arms")


@pytest.fixture(scope="module")
def server(folder: Path, request: pytest.FixtureRequest) -> Iterator[RunningServer]:
    """A server with the module's CONFIG, in which ``{folder}`` is the folder."""
    config = folder / "arms.toml"
    config.write_text(request.module.CONFIG.format(folder=folder))
    with RunningServer(f"--config {config}") as running:
        yield running


@pytest.fixture
async def client(server: RunningServer) -> AsyncIterator[FrameClient]:
    async with frame_client(server.url) as connected:
        await connected.open_goals()
        await connected.subscribe("/joint_states", "sensor_msgs/JointState")
        yield connected


@pytest.fixture(scope="module")
def systemd(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Systemd]:
    listening = Systemd(tmp_path_factory.mktemp("systemd") / "notify")
    yield listening
    listening.close()
