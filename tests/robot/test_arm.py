"""The server's handle on an arm process, whose servos are emulated within it; all tests have the same process."""

import asyncio
import functools
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pytest_asyncio

from harness.waiting import TIMEOUT_S, until
from robot.arm import NO_MOTION, STATE_POLL_S, Arm
from robot.messages import Mode, MotionEnded, MotionProgress, Order, Outcome
from robot.stop_epochs import STOP_EPOCHS
from tests.helpers.arm_on_servos import ArmOnServos, to
from tests.helpers.fake_arm import FakeArm
from tests.helpers.motions import smooth_move

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def running(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[ArmOnServos]:
    made = ArmOnServos(tmp_path_factory.mktemp("arm"))
    await made.start()
    yield made
    await made.arm.close()


@pytest_asyncio.fixture(loop_scope="module")
async def rig(running: ArmOnServos) -> ArmOnServos:
    """The arm, which holds with its pan at 0."""
    # As the server does after a standstill: between tests no event loop runs, nor its heartbeat.
    running.arm.stop()
    if running.arm.state.mode is Mode.FAULT:
        assert (await running.arm.order(Order.RESET_FAULT)).done
    if running.arm.state.mode is not Mode.HOLDING:
        assert (await running.arm.order(Order.ENABLE)).done
    home = smooth_move(
        {"shoulder_pan": (running.arm.state.goal_rad[0], 0.0), "wrist_roll": (running.arm.state.goal_rad[4], 0.0)}, 1.0
    )
    assert (await running.arm.execute(home)).outcome is Outcome.REACHED
    running.states.clear()
    return running


async def test_an_arm_begins_with_a_stop_so_that_numbers_of_an_earlier_run_are_older(tmp_path: Path) -> None:
    before = STOP_EPOCHS.present
    assert ArmOnServos(tmp_path).arm.last_stop > before


async def test_a_stop_right_behind_a_trajectory_is_not_lost(rig: ArmOnServos) -> None:
    motion = rig.arm.execute(to(1.0))
    rig.arm.stop()
    assert (await asyncio.wait_for(motion, TIMEOUT_S)).outcome is Outcome.STOPPED


async def test_what_was_requested_before_a_stop_moves_nothing_however_late_it_is_sent(rig: ArmOnServos) -> None:
    before = STOP_EPOCHS.present
    rig.arm.stop()
    for late in (rig.arm.execute(to(1.0), epoch=before), rig.arm.stream(("shoulder_pan",), before).ended):
        assert (await asyncio.wait_for(late, TIMEOUT_S)).outcome is Outcome.STOPPED
    assert not (await rig.arm.order(Order.ENABLE, epoch=before)).done
    assert (await rig.arm.execute(to(0.1), epoch=STOP_EPOCHS.present)).outcome is Outcome.REACHED


async def test_one_of_two_motions_is_stopped(rig: ArmOnServos) -> None:
    pan = rig.arm.execute(to(0.6))
    roll = rig.arm.execute(smooth_move({"wrist_roll": (0.0, 1.0)}, 2.0))
    rig.arm.stop(roll)
    assert (await asyncio.wait_for(roll, TIMEOUT_S)).outcome is Outcome.STOPPED
    assert (await pan).outcome is Outcome.REACHED


@pytest.mark.stepped_time
async def test_the_refusal_of_a_motion_does_not_wait_for_the_next_state_as_an_end_and_a_way_to_rest_do() -> None:
    arm: Any = FakeArm()
    loop = asyncio.get_running_loop()
    arm._motions, arm._held = {1: loop.create_future(), 2: loop.create_future()}, []
    arm._answer = functools.partial(Arm._answer, arm)
    for number, outcome in ((1, Outcome.REFUSED), (2, Outcome.STOPPED)):
        Arm._received(arm, MotionEnded(number, outcome, ""))
    assert [motion.done() for motion in arm._motions.values()] == [True, False]
    arm._motions = {}
    arm.state = replace(arm.state, motions=(MotionProgress(NO_MOTION, 0.5, 1.0),))
    resting = asyncio.create_task(Arm.rest(arm, TIMEOUT_S))
    await asyncio.sleep(2.5 * STATE_POLL_S)
    assert not resting.done()
    arm.state = replace(arm.state, motions=())
    assert await resting


async def test_an_arm_whose_bus_is_gone_is_found_when_it_is_back(rig: ArmOnServos) -> None:
    rig.emulator.command(plugged=False)
    await until(lambda: rig.arm.state.mode is Mode.DISCONNECTED)
    assert "unplugged" in rig.arm.state.reason
    rig.emulator.command(plugged=True)
    await until(lambda: rig.arm.state.mode is Mode.HOLDING)


class Stick:
    """Steers the pan in one direction, in a new stream where a busy machine let the last one run dry."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self.stream = arm.stream(("shoulder_pan",))

    @property
    def speed_rad_s(self) -> float:
        """Speed that the arm is told, once it is steered again."""
        if self.stream.ended.done():
            self.stream = self._arm.stream(("shoulder_pan",))
        self.stream.steer(np.array([0.5]))
        return 0.0 if self.stream.commanded is None else float(self.stream.commanded.velocity_rad_s[0])


async def test_a_stream_follows_its_setpoints_until_it_is_ended_for_who_needs_the_arm(rig: ArmOnServos) -> None:
    assert await rig.arm.end_streams(TIMEOUT_S)
    stick = Stick(rig.arm)
    await until(lambda: stick.speed_rad_s == pytest.approx(0.5, abs=0.01) and rig.pan_rad > 0.15)
    assert await rig.arm.end_streams(TIMEOUT_S)
    assert (await asyncio.wait_for(stick.stream.ended, TIMEOUT_S)).outcome is Outcome.STOPPED
    assert rig.arm.state.goal_rad[0] > 0.15
