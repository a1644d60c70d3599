"""The contract of an arm, on the ideal arm and on emulated servos; tests/processes/robot runs it on other kinds."""

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from tests.helpers.arm_contract import ArmContract, Place, place_of


@pytest_asyncio.fixture(loop_scope="module", scope="module", params=["ideal", "emulated, lerobot"])
async def place(request: pytest.FixtureRequest) -> AsyncIterator[Place]:
    async with place_of(request.param) as made:
        yield made


@pytest.mark.asyncio(loop_scope="module")
class TestArmContract(ArmContract):
    """Contract of every arm; each test leaves it holding where it was, or near."""
