"""A server for each module, clients of it, and a notifier of systemd."""

from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from harness.clients import ArmClient, FrameClient, arm_client, frame_client
from harness.server import RunningServer
from tests.helpers.systemd import Systemd


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("arms")


@pytest.fixture(scope="module")
def server(folder: Path, request: pytest.FixtureRequest) -> Iterator[RunningServer]:
    """A server with the module's ARGUMENTS and SETTINGS, and CONFIG as its file; ``{folder}`` in them is the folder."""
    arguments = in_folder(getattr(request.module, "ARGUMENTS", "--port 0"), folder)
    if hasattr(request.module, "CONFIG"):
        config = folder / "arms.toml"
        config.write_text(in_folder(request.module.CONFIG, folder))
        arguments = f"--config {config}"
    settings = getattr(request.module, "SETTINGS", {})
    with RunningServer(arguments, {name: in_folder(text, folder) for name, text in settings.items()}) as running:
        yield running


def in_folder(text: str, folder: Path) -> str:
    return text.replace("{folder}", str(folder))


@pytest.fixture
async def client(server: RunningServer) -> AsyncIterator[FrameClient]:
    async with frame_client(server.url) as connected:
        await connected.open_goals()
        await connected.subscribe("/joint_states", "sensor_msgs/JointState")
        yield connected


@pytest.fixture
async def caller(server: RunningServer) -> AsyncIterator[ArmClient]:
    async with arm_client(server.url) as connected:
        yield connected


@pytest.fixture(scope="module")
def systemd(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Systemd]:
    listening = Systemd(tmp_path_factory.mktemp("systemd") / "notify")
    yield listening
    listening.close()
