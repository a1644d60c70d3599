"""The client of the Python package."""

from collections.abc import Iterator

import pytest

from armbridge_client import Arm, connect
from harness.server import RunningServer


@pytest.fixture
def arm(server: RunningServer) -> Iterator[Arm]:
    with connect(server.url) as connected:
        yield connected
