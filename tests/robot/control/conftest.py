import pytest

from tests.helpers.emulator import SteppedEmulator


@pytest.fixture
def emulator() -> SteppedEmulator:
    return SteppedEmulator(wire_time=False)
