"""The contract of an arm: what a server may rely on, whatever hardware the arm has.

tests/robot runs it on the ideal arm and on emulated Feetech servos as lerobot leaves them. tests/processes/robot runs
it on emulated Dynamixel servos, on clones of Feetech servos, and, with ``--arm PORT,CALIBRATION``, on a real arm. The
servos of a ROS 2 driver, and those at a pseudo terminal, which a busy machine makes silent, are driven by the campaign
of faults. The tests turn the wrist by ``REACH_RAD`` from where they find the arm, and move the gripper by as much; no
other joint moves. Emergency stops hold the arm, and torque is taken off only where nothing can fall. At the end the arm
holds.
"""

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Any

import pytest
import pytest_asyncio

from harness.waiting import TIMEOUT_S, until
from robot.arm import Arm
from robot.calibration import Calibration, find_calibration
from robot.description.limits import within_calibration
from robot.hardware.config import EmulatedConfig, HardwareConfig, IdealConfig, SerialConfig
from robot.messages import (
    ArmConfig,
    ArmState,
    CommandDone,
    EmergencyPolicy,
    Mode,
    MotionEnded,
    Order,
    Outcome,
)
from robot.trajectory import Trajectory
from tests.helpers import dynamixel
from tests.helpers.motions import smooth_move
from tests.helpers.robots import SO101, SO101_SERVOS, nominal_calibration, so101

# Without weight on it, and with room to both sides.
JOINT = "wrist_roll"
REACH_RAD = 0.15
DURATION_S = 0.6

# Backlash and droop of a real arm.
WITHIN_RAD = 0.06

# 30 ticks: nothing moves when torque comes on.
STILL_RAD = 0.046


class Watched(Arm):
    """An arm that keeps what its process said."""

    def __init__(self, config: ArmConfig) -> None:
        self.states: list[ArmState] = []
        self.ended: list[MotionEnded] = []
        self.done: list[CommandDone] = []
        super().__init__(config, self.states.append)

    def _received(self, message: Any) -> None:
        if isinstance(message, MotionEnded):
            self.ended.append(message)
        elif isinstance(message, CommandDone):
            self.done.append(message)
        super()._received(message)


@dataclass
class Place:
    """An arm somewhere.

    Attributes:
        config: how it is driven.
        may_fall: whether torque may be taken off.
    """

    config: ArmConfig
    may_fall: bool
    arm: Watched = field(init=False)

    async def start(self) -> None:
        self.arm = Watched(self.config)
        await self.arm.start(TIMEOUT_S)
        await until(lambda: self.arm.state.mode is Mode.HOLDING)

    async def outcome(self, trajectory: Trajectory) -> Outcome:
        """Execute a trajectory; return how it ended."""
        return (await self.answer(self.arm.execute(trajectory))).outcome

    async def answer(self, motion: asyncio.Future[MotionEnded]) -> MotionEnded:
        return await asyncio.wait_for(motion, TIMEOUT_S)

    def at(self, joint: str = JOINT) -> float:
        """Position of a joint [rad]."""
        assert self.arm.state.position_rad is not None
        return float(self.arm.state.position_rad[self.arm.state.joint_names.index(joint)])

    def held(self, joint: str = JOINT) -> float:
        """Goal position of a joint [rad]."""
        assert self.arm.state.goal_rad is not None
        return float(self.arm.state.goal_rad[self.arm.state.joint_names.index(joint)])

    def move(self, way_rad: float, joint: str = JOINT, duration_s: float = DURATION_S) -> Trajectory:
        """From where the joint is held, so far."""
        return smooth_move({joint: (self.held(joint), self.held(joint) + way_rad)}, duration_s)


NOMINAL = nominal_calibration()
START_RAD = (0.1, -0.5, 0.4, 0.2, 0.1, 0.3)
START = dict(zip((joint.joint for joint in NOMINAL.joints), START_RAD, strict=True))

# Slow enough for a busy machine to notice that the arm is on its way before it is there.
SLOW_S = 12.0
ON_ITS_WAY_RAD = 0.05 * REACH_RAD


@contextlib.asynccontextmanager
async def place_of(kind: str, real_arm: str | None = None) -> AsyncIterator[Place]:
    """Start an arm of a kind, the real one by its port and calibration, and close it at the end."""
    kind, _, population = kind.partition(", ")
    hardware: HardwareConfig = IdealConfig(start_rad=START)
    robot, calibration = so101(), NOMINAL
    if kind == "emulated":
        hardware = EmulatedConfig(NOMINAL, start_rad=START, population=population)
    elif kind == "emulated Dynamixel servos":
        robot, calibration = dynamixel.KOCH.model, dynamixel.CALIBRATION
        hardware = EmulatedConfig(calibration, kind="dynamixel", start_rad=START)
    elif kind == "real arm" and real_arm:
        port, _, file = real_arm.partition(",")
        calibration = Calibration.load(find_calibration(file, SO101.hardware.calibrations, os.environ), SO101_SERVOS)
        hardware = SerialConfig(calibration, port)
    elif kind != "ideal":
        pytest.skip("no real arm is named by --arm PORT,CALIBRATION")
    config = ArmConfig(within_calibration(robot, calibration), hardware, on_emergency_stop=EmergencyPolicy.HOLD)
    made = Place(config, may_fall=kind != "real arm")
    try:
        await made.start()
        yield made
    finally:
        await made.arm.close()


class ArmContract:
    """Contract of every arm; each test leaves it holding where it was, or near."""

    @pytest_asyncio.fixture(loop_scope="module", autouse=True)
    async def _acknowledged(self, place: Place) -> None:
        """Stop the arm, as the server does after a standstill: between tests no event loop runs, nor its heartbeat."""
        place.arm.stop()

    async def test_an_arm_that_holds_is_at_its_goals(self, place: Place) -> None:
        state = place.arm.state
        assert state.goal_rad is not None
        assert state.position_rad is not None
        assert abs(state.goal_rad - state.position_rad).max() < STILL_RAD

    async def test_a_motion_arrives_and_its_end_is_reported_once_by_states_that_hold(self, place: Place) -> None:
        start, before, seen = place.held(), len(place.arm.ended), len(place.arm.states)
        for way_rad, end_rad in [(REACH_RAD, start + REACH_RAD), (-REACH_RAD, start)] * 2:
            assert await place.outcome(place.move(way_rad)) is Outcome.REACHED
            assert place.arm.state.mode is Mode.HOLDING
            await until(lambda end_rad=end_rad: abs(place.at() - end_rad) < WITHIN_RAD)
        numbers = [ended.motion_id for ended in place.arm.ended[before:]]
        assert len(numbers) == len(set(numbers)) == 4
        states = place.arm.states[seen:]
        for motion in numbers:
            moving = [one for each in states if each.mode is Mode.MOVING for one in each.motions]
            fractions = [one.fraction for one in moving if one.motion_id == motion]
            assert fractions == sorted(fractions) != []
        assert [state.stamp_s for state in states] == sorted(state.stamp_s for state in states)

    async def test_a_stop_ends_the_motion_on_the_way(self, place: Place) -> None:
        start = place.held()
        motion = place.arm.execute(place.move(REACH_RAD, duration_s=SLOW_S))
        await until(lambda: place.held() - start > ON_ITS_WAY_RAD)
        place.arm.stop()
        assert (await place.answer(motion)).outcome is Outcome.STOPPED
        assert place.arm.state.mode is Mode.HOLDING
        assert ON_ITS_WAY_RAD < place.held() - start < 0.9 * REACH_RAD
        await place.outcome(place.move(start - place.held()))

    async def test_a_motion_from_elsewhere_or_beyond_the_limits_is_refused(self, place: Place) -> None:
        held = place.held()
        for (start, end, duration_s), word in {
            (held + 0.3, held + 0.4, 1.0): JOINT,
            (held, 3.0, 10.0): "limits",
        }.items():
            refused = await place.answer(place.arm.execute(smooth_move({JOINT: (start, end)}, duration_s)))
            assert (refused.outcome, word in refused.message) == (Outcome.REFUSED, True), refused
        assert place.held() == held

    async def test_a_joint_has_one_motion_at_a_time_and_the_gripper_its_own(self, place: Place) -> None:
        gripper = place.arm.execute(place.move(REACH_RAD, "gripper"))
        first = place.arm.execute(place.move(REACH_RAD))
        assert await place.outcome(place.move(REACH_RAD)) is Outcome.REFUSED
        assert (await place.answer(first)).outcome is Outcome.REACHED
        assert (await place.answer(gripper)).outcome is Outcome.REACHED
        await until(lambda: place.arm.state.mode is Mode.HOLDING)
        await place.outcome(place.move(-REACH_RAD))
        await place.outcome(place.move(-REACH_RAD, "gripper"))

    async def test_an_emergency_stop_ends_the_motion_and_stays_until_it_is_reset(self, place: Place) -> None:
        start = place.held()
        motion = place.arm.execute(place.move(REACH_RAD, duration_s=SLOW_S))
        await until(lambda: place.held() - start > ON_ITS_WAY_RAD)
        assert (await place.arm.order(Order.EMERGENCY_STOP)).done
        assert (await place.answer(motion)).outcome is Outcome.FAULT
        assert await place.outcome(place.move(0.05)) is Outcome.REFUSED
        assert (await place.arm.order(Order.RESET_FAULT)).done
        await until(lambda: place.arm.state.mode is Mode.HOLDING)
        assert await place.outcome(place.move(start - place.held())) is Outcome.REACHED

    async def test_a_relaxed_arm_refuses_motions_and_is_enabled_where_it_is(self, place: Place) -> None:
        if not place.may_fall:
            return
        assert (await place.arm.order(Order.RELAX)).done
        refused = await place.answer(place.arm.execute(place.move(0.05)))
        assert refused.outcome is Outcome.REFUSED
        assert "enable" in refused.message
        assert (await place.arm.order(Order.ENABLE)).done
        await until(lambda: place.arm.state.mode is Mode.HOLDING)
        await until(lambda: abs(place.held() - place.at()) < STILL_RAD)
