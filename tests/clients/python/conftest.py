"""A server whose simulated arm moves as fast as its limits allow, and the client of the Python package."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from armbridge_client import Arm, connect
from harness.server import FAST, RunningServer


@pytest.fixture(scope="package")
def package_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    states: Path = tmp_path_factory.mktemp("data") / "states.json"
    with RunningServer(settings={**FAST, "ARMBRIDGE_GOALS__NAMED_STATES_FILE": str(states)}) as running:
        yield running


@pytest.fixture(scope="module")
def server(package_server: RunningServer) -> RunningServer:
    """The server with confirm mode off, an empty scene and the gripper closed, whatever the module before has left."""
    with connect(package_server.url) as arm:
        arm.set_confirm_mode(on=False)
        arm.scene.clear()
        arm.gripper.close()
    return package_server


@pytest.fixture
def arm(server: RunningServer) -> Iterator[Arm]:
    with connect(server.url) as connected:
        yield connected
