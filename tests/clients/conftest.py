from collections.abc import Iterator

import pytest

from harness.server import RunningServer


@pytest.fixture(scope="session")
def server() -> Iterator[RunningServer]:
    """Server of all scenarios; a start takes four seconds of processor time."""
    with RunningServer() as running:
        yield running
