"""The arm process, and the contract of an arm by its handle."""

import asyncio
import os
import signal
from collections.abc import AsyncIterator
from typing import Any

import numpy as np
import pytest
import pytest_asyncio

from harness.waiting import TIMEOUT_S, until
from robot.arm import ArmProcess, ArmStream, start_arm_process
from robot.hardware.config import SerialConfig
from robot.messages import ArmConfig, ArmState, Command, CommandDone, Mode, MotionEnded, Order, Outcome, Setpoint
from robot.processes import StartedChild
from tests.helpers.arm_contract import STILL_RAD, ArmContract, Place, place_of
from tests.helpers.robots import nominal_calibration, so101

CONFIG = ArmConfig(so101(), SerialConfig(nominal_calibration(), "/dev/does-not-exist"))


class ProcessRig:
    """An arm process and its messages."""

    def __init__(self, started: StartedChild | None = None) -> None:
        self.messages: list[Any] = []
        self.exits = 0
        self.process = ArmProcess(self.messages.append, self._exited, started)

    def _exited(self) -> None:
        self.exits += 1

    async def until_message(self, kind: type) -> Any:
        await until(lambda: any(isinstance(message, kind) for message in self.messages))
        return next(message for message in self.messages if isinstance(message, kind))


@pytest.fixture
async def rig() -> AsyncIterator[ProcessRig]:
    made = ProcessRig()
    await made.process.launch()
    yield made
    await made.process.kill()


async def test_what_is_sent_before_the_configuration_does_not_take_its_place(rig: ProcessRig) -> None:
    rig.process.send(Command(0, Order.EMERGENCY_STOP))
    assert not rig.process.configured
    rig.process.configure(CONFIG)
    assert "/dev/does-not-exist" in (await rig.until_message(ArmState)).reason
    rig.process.send(Command(1, Order.EMERGENCY_STOP))
    answer = await rig.until_message(CommandDone)
    assert (answer.number, answer.done) == (1, False)
    assert "not connected" in answer.message


async def test_a_process_that_was_started_ahead_is_the_first_and_only_the_first() -> None:
    started = start_arm_process()
    rig = ProcessRig(started)
    await rig.process.launch()
    assert rig.process.pid == started.process.pid
    rig.process.configure(CONFIG)
    await rig.until_message(ArmState)
    await rig.process.kill()
    await rig.process.launch()
    assert (rig.exits, rig.process.pid != started.process.pid) == (1, True)
    # One that was never configured ends as well.
    await asyncio.wait_for(rig.process.kill(), TIMEOUT_S)
    assert rig.exits == 2


async def test_a_process_that_has_died_is_not_configured(rig: ProcessRig) -> None:
    rig.process.configure(CONFIG)
    await rig.process.kill()
    assert (rig.exits, rig.process.configured) == (1, False)
    rig.process.configure(CONFIG)
    assert not rig.process.configured


async def test_setpoints_go_out_under_the_streams_number_until_it_has_ended() -> None:
    sent: list[Setpoint] = []
    ended: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
    stream = ArmStream(5, ("shoulder_pan",), ended, sent.append)
    stream.steer(np.array([0.3]))
    ended.set_result(MotionEnded(5, Outcome.STOPPED, "stopped"))
    stream.steer(np.array([0.4]))
    assert [(each.motion_id, each.velocity_rad_s.tolist()) for each in sent] == [(5, [0.3])]


KINDS = ["emulated Dynamixel servos", "emulated, clone", "real arm"]


@pytest_asyncio.fixture(loop_scope="module", scope="module", params=KINDS)
async def place(request: pytest.FixtureRequest) -> AsyncIterator[Place]:
    async with place_of(request.param, request.config.getoption("--arm")) as made:
        yield made


@pytest.mark.asyncio(loop_scope="module")
class TestArmContract(ArmContract):
    """Contract of every arm; each test leaves it holding where it was, or near."""

    async def test_a_killed_arm_process_is_replaced_and_adopts_the_arm(self, place: Place) -> None:
        held, killed = place.held(), place.arm.pid
        assert killed is not None
        os.kill(killed, signal.SIGKILL)
        await until(lambda: place.arm.pid != killed and place.arm.state.mode is Mode.HOLDING)
        assert abs(place.held() - held) < STILL_RAD

    async def test_an_arm_that_was_closed_holds_until_the_next_process_finds_it(self, place: Place) -> None:
        if place.config.hardware.simulated:
            pytest.skip("a simulated arm ends with its process")
        held = place.held()
        await place.arm.close()
        await place.start()
        assert abs(place.held() - held) < STILL_RAD
