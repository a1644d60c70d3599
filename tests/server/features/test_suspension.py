"""A machine that was suspended, in stepped time."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace

import numpy as np
import pytest

from robot.trajectory import PERIOD_S
from server.features.context import ArmContext
from server.features.suspension import LEAST_S, LOOK_S, Bounds, Suspension, suspended_s
from tests.helpers.stage import RecordedStage

pytestmark = pytest.mark.stepped_time

GOAL = "/moveit_goal_joints"


class Laptop(RecordedStage):
    """A server that moves its arm, on a machine with a lid.

    Attributes:
        suspended: bounds of the time for which the machine was suspended [s].
        results: messages of the goals' results.
    """

    def __init__(self) -> None:
        super().__init__()
        self.suspended: Bounds = (0.0, 0.0)
        self.results: list[str] = []
        self.suspension = Suspension(self.stage.context, lambda: self.suspended)
        self.stage._features += (self.suspension,)
        listener = self.stage.graph.node("listener")
        result = "/moveit_goal_result", "moveit_msgs/MoveItErrorCodes"
        listener.subscribe(*result, lambda published: self.results.append(published.msg["message"]))

    async def begin_to_move(self) -> None:
        """Move to one place and then to another; returns on the way to the first."""
        for pan_rad in (1.2, -1.2):
            self.publish_now(GOAL, "sensor_msgs/JointState", {"name": ["shoulder_pan"], "position": [pan_rad]})
        while not self.goals_rad or self.goals_rad[-1][0] < 0.2:
            await asyncio.sleep(PERIOD_S)


@pytest.fixture
async def laptop() -> AsyncIterator[Laptop]:
    laptop = Laptop()
    await laptop.suspension.start()
    async for each in laptop.run():
        yield each


SUSPENDED, HALTED = "the machine was suspended for 3600 s", "the arm process stood still for 60.0 s"


@pytest.mark.parametrize("reason", [SUSPENDED, HALTED])
async def test_after_a_suspension_or_a_standstill_of_the_arm_process_the_arm_brakes_and_only_later_goals_begin(
    laptop: Laptop, reason: str
) -> None:
    await laptop.begin_to_move()
    if reason is SUSPENDED:
        laptop.suspended = (3600.0, 3600.0)
    else:
        laptop.arm.rig.clock.advance(60.0)
    await asyncio.sleep(2.0)
    waiting, active = laptop.results
    assert waiting == f"{reason} before this goal's turn came"
    assert active.startswith(f"{reason}; the arm stands at ")
    assert np.ptp(laptop.arm_rad[-100:, 0]) == 0.0
    assert 0.2 < laptop.goals_rad[-1][0] < 1.0
    await laptop.begin_to_move()


async def test_states_that_are_older_than_the_stop_after_a_standstill_lead_to_no_other_stop(laptop: Laptop) -> None:
    halted = replace(laptop.arm.state, halted="the arm process stood still for 60.0 s", last_stop=laptop.arm.last_stop)
    laptop.suspension.on_state("", halted)
    stopped = laptop.arm.last_stop
    assert stopped > halted.last_stop
    laptop.suspension.on_state("", halted)
    assert laptop.arm.last_stop == stopped


async def test_clocks_that_are_read_late_are_no_suspension(laptop: Laptop) -> None:
    await laptop.begin_to_move()
    for laptop.suspended in ((-10.0, 0.0), (0.0, 10.0), (0.9 * LEAST_S, 0.9 * LEAST_S)):
        await asyncio.sleep(2.0 * LOOK_S)
    assert laptop.results == []


async def test_a_stop_that_fails_does_not_end_the_watch(laptop: Laptop, monkeypatch: pytest.MonkeyPatch) -> None:
    reasons: list[str] = []

    def fail(_context: ArmContext, reason: str) -> None:
        reasons.append(reason)
        raise ValueError(reason)

    monkeypatch.setattr(ArmContext, "stop", fail)
    asyncio.get_running_loop().set_exception_handler(lambda *_failure: None)
    for length_s in (10.0, 30.0):
        laptop.suspended = (length_s, length_s)
        await asyncio.sleep(2.0 * LOOK_S)
    assert reasons == [f"the machine was suspended for {length} s" for length in (10, 20)]


def test_the_bounds_are_about_clocks_that_are_read_in_a_row() -> None:
    least_s, greatest_s = suspended_s()
    assert least_s <= greatest_s
    assert greatest_s >= 0.0
