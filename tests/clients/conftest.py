"""The servers of all clients, whose simulated arms move as fast as their limits allow."""

from collections.abc import Iterator

import pytest

from armbridge_client import connect
from harness.server import FAST, RunningServer

MODEL, PERSON, VIEWER = "p" * 24, "o" * 24, "v" * 24
TOKENS = {
    "ARMBRIDGE_ACCESS__PROPOSE_TOKENS__MODEL": MODEL,
    "ARMBRIDGE_ACCESS__OPERATE_TOKENS__ADA": PERSON,
    "ARMBRIDGE_ACCESS__VIEW_TOKENS__SCREEN": VIEWER,
}


@pytest.fixture(scope="module")
def server(simulated_server: RunningServer) -> RunningServer:
    """The server as it was at its start, whatever the module before has left."""
    with connect(simulated_server.url) as arm:
        arm.set_confirm_mode(on=False)
        arm.scene.clear()
        arm.gripper.close()
        arm.move_named("home")
    return simulated_server


@pytest.fixture(scope="session")
def guarded() -> Iterator[RunningServer]:
    """A server with tokens."""
    with RunningServer(settings={**FAST, **TOKENS}) as running:
        yield running


@pytest.fixture(scope="session")
def ros1_server() -> Iterator[RunningServer]:
    """A server that takes clients without a word about it for those of ROS 1."""
    with RunningServer(settings={**FAST, "ARMBRIDGE_SERVER__ROS_VERSION": "1"}) as running:
        yield running


OF_DIALECT = {"ros1": "ros1_server", "ros2": "simulated_server"}
