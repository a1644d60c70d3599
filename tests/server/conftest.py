"""A server whose arm is on an emulator that the tests command; it is set right again before each of them."""

import asyncio
import logging
from collections.abc import AsyncIterator, Iterator

import pytest

from harness.clients import ArmClient, arm_client, values_of
from harness.server import ServerOnBus, server_on_bus
from harness.waiting import TIMEOUT_S
from robot import logs
from robot.logs import OUR_LOGGER
from tests.helpers.robots import nominal_calibration

JOINTS = {joint.joint: joint for joint in nominal_calibration().joints}
FAST = {"MOVEIT__MAX_VELOCITY_SCALING": "1.0", "MOVEIT__MAX_ACCELERATION_SCALING": "1.0"}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the tests of the shared server last: it costs an eighth of a core as long as it lives."""
    items.sort(key=lambda item: "served" in getattr(item, "fixturenames", ()))


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerOnBus]:
    states = tmp_path_factory.mktemp("served") / "named_states.json"
    with server_on_bus(**FAST, GOALS__NAMED_STATES_FILE=str(states)) as running:
        yield running


@pytest.fixture
async def client(served: ServerOnBus) -> AsyncIterator[ArmClient]:
    served.emulator.command(online=[1, 2, 3, 4, 5, 6], obstacle={str(servo): None for servo in range(1, 7)})
    async with arm_client(served.server.url) as connected:
        await connected.call("/arm/stop")
        async with asyncio.timeout(TIMEOUT_S):
            while values_of((await connected.until("/arm/state", bool))[-1])["mode"] != "holding":
                await connected.call("/arm/reset_fault")
                await connected.call("/arm/enable")
        await connected.call("/arm/release_control")
        yield connected


@pytest.fixture
def levels_are_put_back(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(logs, "_changed", {})
    before = {name: logging.getLogger(name).level for name in (OUR_LOGGER, "armbridge.gateway")}
    yield
    for name, level in before.items():
        logging.getLogger(name).setLevel(level)
