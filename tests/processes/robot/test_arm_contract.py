"""The contract on the kinds of arms that tests/robot leaves out, and for arm processes that are killed or closed."""

import os
import signal
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from harness.waiting import until
from robot.messages import Mode
from tests.helpers.arm_contract import STILL_RAD, ArmContract, Place, place_of

# Populations of Feetech servos: tests/robot has lerobot, and a kit gets no torque before its ids are set.
FOUND = ("factory", "ros2_driver", "clone")
KINDS = ["emulated Dynamixel servos", *(f"pseudo terminal, {name}" for name in FOUND), "real arm"]


@pytest_asyncio.fixture(loop_scope="module", scope="module", params=KINDS)
async def place(request: pytest.FixtureRequest) -> AsyncIterator[Place]:
    async with place_of(request.param, request.config.getoption("--arm")) as made:
        yield made


@pytest.mark.asyncio(loop_scope="module")
class TestArmContract(ArmContract):
    """Contract of every arm; each test leaves it holding where it was, or near."""

    async def test_a_killed_arm_process_is_replaced_and_adopts_the_arm(self, place: Place) -> None:
        held = place.held()
        assert place.arm.pid is not None
        os.kill(place.arm.pid, signal.SIGKILL)
        await until(lambda: place.arm.state.mode is Mode.DISCONNECTED)
        await until(lambda: place.arm.state.mode is Mode.HOLDING)
        assert abs(place.held() - held) < STILL_RAD

    async def test_an_arm_that_was_closed_holds_until_the_next_process_finds_it(self, place: Place) -> None:
        if place.config.hardware.simulated:
            pytest.skip("a simulated arm ends with its process")
        held = place.held()
        await place.arm.close()
        await place.start()
        assert abs(place.held() - held) < STILL_RAD
