"""A server whose simulated arm moves as fast as its limits allow, and the client of the Python package."""

from collections.abc import Iterator

import pytest

from armbridge_client import Arm, connect
from harness.server import RunningServer


@pytest.fixture(scope="session")
def server(simulated_server: RunningServer) -> RunningServer:
    return simulated_server


@pytest.fixture
def arm(server: RunningServer) -> Iterator[Arm]:
    with connect(server.url) as connected:
        yield connected
