"""The contract of an arm: what a server may rely on, whatever is at the other end of the bus.

tests/robot tries it on the ideal arm and on emulated servos in the arm process; tests/processes/robot on those of
Dynamixel as well, on Feetech's on a pseudo terminal, in every state in which they may be found
(:mod:`robot.emulator.populations`), and, with ``--arm PORT,CALIBRATION``, on a real arm. The tests
turn the wrist by ``REACH_RAD`` from where the arm is found, and move the gripper by as much; nothing else moves.
Emergency stops hold, and torque is taken off only where nothing falls; at the end the arm holds.
"""

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from harness.emulator import RunningEmulator
from harness.waiting import TIMEOUT_S, until
from robot.arm import Arm
from robot.calibration import Calibration, find_calibration
from robot.description.limits import within_calibration
from robot.description.model import RobotModel
from robot.emulator.populations import POPULATIONS
from robot.hardware.config import EmulatedConfig, HardwareConfig, IdealConfig, SerialConfig
from robot.messages import ArmConfig, ArmState, EmergencyPolicy, Mode, MotionEnded, Order, Outcome
from robot.trajectory import Trajectory
from tests.helpers import dynamixel
from tests.helpers.motions import smooth_move
from tests.helpers.robots import SO101, SO101_SERVOS, nominal_calibration, recalibrated, so101

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
        super().__init__(config, self.states.append)

    def _received(self, message: Any) -> None:
        if isinstance(message, MotionEnded):
            self.ended.append(message)
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
        await self.until(lambda: self.arm.state.mode is Mode.HOLDING)

    async def until(self, condition: Callable[[], bool]) -> None:
        await until(condition)

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

# Servos that get no torque before the arm was calibrated, or their ids were set.
UNFIT = ("ros2_driver", "kit")

# Kinds of arms: those whose servos are within the arm process, and those at the other end of a line.
IN_PROCESS = ("ideal", "emulated Dynamixel servos", *(f"emulated, {name}" for name in POPULATIONS if name not in UNFIT))
ON_LINES = (*(f"pseudo terminal, {name}" for name in POPULATIONS if name != "kit"), "real arm")

# Slow enough for a busy machine to notice that the arm is on its way before it is there.
SLOW_S = 6.0


def place_with(
    hardware: HardwareConfig,
    calibration: Calibration = NOMINAL,
    *,
    may_fall: bool = True,
    model: RobotModel | None = None,
) -> Place:
    robot = within_calibration(model or so101(), calibration)
    config = ArmConfig(robot, hardware, on_emergency_stop=EmergencyPolicy.HOLD)
    return Place(config, may_fall)


@contextlib.asynccontextmanager
async def place_of(kind: str, real_arm: str | None = None) -> AsyncIterator[Place]:
    """Start an arm of a kind, the real one by its port and calibration, and close it at the end."""
    bus: RunningEmulator | None = None
    kind, _, population = kind.partition(", ")
    if kind == "emulated":
        made = place_with(EmulatedConfig(NOMINAL, start_rad=START, population=population))
    elif kind == "emulated Dynamixel servos":
        config = EmulatedConfig(dynamixel.CALIBRATION, kind="dynamixel", start_rad=START)
        made = place_with(config, dynamixel.CALIBRATION, model=dynamixel.KOCH.model)
    elif kind == "ideal":
        made = place_with(IdealConfig(start_rad=START))
    elif kind == "pseudo terminal":
        bus = RunningEmulator(f"--start={','.join(map(str, START_RAD))}", "--population", population)
        calibration = recalibrated(NOMINAL, POPULATIONS[population])
        made = place_with(SerialConfig(calibration, bus.port), calibration)
    elif real_arm:
        port, _, file = real_arm.partition(",")
        calibration = Calibration.load(find_calibration(file, SO101.hardware.calibrations, os.environ), SO101_SERVOS)
        made = place_with(SerialConfig(calibration, port), calibration, may_fall=False)
    else:
        pytest.skip("no real arm is named by --arm PORT,CALIBRATION")
    try:
        await made.start()
        yield made
    finally:
        await made.arm.close()
        if bus is not None:
            bus.end()


class ArmContract:
    """Contract of every arm; each test leaves it holding where it was, or near."""

    async def test_an_arm_that_holds_is_at_its_goals(self, place: Place) -> None:
        state = place.arm.state
        assert state.goal_rad is not None
        assert state.position_rad is not None
        assert abs(state.goal_rad - state.position_rad).max() < STILL_RAD

    async def test_a_motion_arrives_and_its_end_is_reported_once(self, place: Place) -> None:
        start = place.held()
        before = len(place.arm.ended)
        there = await place.answer(place.arm.execute(place.move(REACH_RAD)))
        assert there.outcome is Outcome.REACHED
        await place.until(lambda: abs(place.at() - start - REACH_RAD) < WITHIN_RAD)
        back = await place.answer(place.arm.execute(smooth_move({JOINT: (start + REACH_RAD, start)}, DURATION_S)))
        assert back.outcome is Outcome.REACHED
        numbers = [ended.motion_id for ended in place.arm.ended[before:]]
        assert len(numbers) == len(set(numbers)) == 2

    async def test_the_state_at_the_end_of_a_motion_holds(self, place: Place) -> None:
        for way_rad in (REACH_RAD, -REACH_RAD, REACH_RAD, -REACH_RAD):
            await place.answer(place.arm.execute(place.move(way_rad)))
            assert place.arm.state.mode is Mode.HOLDING

    async def test_states_follow_each_other_and_report_the_motion(self, place: Place) -> None:
        before = len(place.arm.states)
        await place.answer(place.arm.execute(place.move(REACH_RAD)))
        await place.answer(place.arm.execute(place.move(-REACH_RAD)))
        states = place.arm.states[before:]
        moving = [state for state in states if state.mode is Mode.MOVING]
        assert moving
        for motion in {state.motion_id for state in moving}:
            fractions = [state.fraction for state in moving if state.motion_id == motion]
            assert motion is not None
            assert fractions == sorted(fractions)
        stamps = [state.stamp_s for state in states]
        assert stamps == sorted(stamps)

    async def test_a_stop_ends_the_motion_on_the_way(self, place: Place) -> None:
        start = place.held()
        motion = place.arm.execute(place.move(REACH_RAD, duration_s=SLOW_S))
        await place.until(lambda: abs(place.held() - start) > 0.2 * REACH_RAD)
        place.arm.stop()
        assert (await place.answer(motion)).outcome is Outcome.STOPPED
        assert place.arm.state.mode is Mode.HOLDING
        assert 0.2 * REACH_RAD < place.held() - start < 0.9 * REACH_RAD
        await place.answer(place.arm.execute(place.move(start - place.held())))

    async def test_a_motion_from_elsewhere_is_refused(self, place: Place) -> None:
        held = place.held()
        refused = await place.answer(place.arm.execute(smooth_move({JOINT: (held + 0.3, held + 0.4)}, 1.0)))
        assert refused.outcome is Outcome.REFUSED
        assert JOINT in refused.message

    async def test_a_motion_beyond_the_limits_is_refused_before_it_begins(self, place: Place) -> None:
        held = place.held()
        refused = await place.answer(place.arm.execute(smooth_move({JOINT: (held, 3.0)}, 10.0)))
        assert refused.outcome is Outcome.REFUSED
        assert "limits" in refused.message
        assert place.held() == held

    async def test_a_joint_has_one_motion_at_a_time_and_the_gripper_its_own(self, place: Place) -> None:
        gripper = place.arm.execute(place.move(REACH_RAD, "gripper"))
        first = place.arm.execute(place.move(REACH_RAD))
        second = await place.answer(place.arm.execute(place.move(REACH_RAD)))
        assert second.outcome is Outcome.REFUSED
        assert (await place.answer(first)).outcome is Outcome.REACHED
        assert (await place.answer(gripper)).outcome is Outcome.REACHED
        await place.until(lambda: place.arm.state.mode is Mode.HOLDING)
        await place.answer(place.arm.execute(place.move(-REACH_RAD)))
        await place.answer(place.arm.execute(place.move(-REACH_RAD, "gripper")))

    async def test_an_emergency_stop_ends_the_motion_and_stays_until_it_is_reset(self, place: Place) -> None:
        start = place.held()
        motion = place.arm.execute(place.move(REACH_RAD, duration_s=SLOW_S))
        await place.until(lambda: abs(place.held() - start) > 0.2 * REACH_RAD)
        assert (await place.arm.order(Order.EMERGENCY_STOP)).done
        assert (await place.answer(motion)).outcome is Outcome.FAULT
        refused = await place.answer(place.arm.execute(place.move(0.05)))
        assert refused.outcome is Outcome.REFUSED
        assert (await place.arm.order(Order.RESET_FAULT)).done
        await place.until(lambda: place.arm.state.mode is Mode.HOLDING)
        assert (await place.answer(place.arm.execute(place.move(start - place.held())))).outcome is Outcome.REACHED

    async def test_a_relaxed_arm_refuses_motions_and_is_enabled_where_it_is(self, place: Place) -> None:
        if not place.may_fall:
            return
        assert (await place.arm.order(Order.RELAX)).done
        refused = await place.answer(place.arm.execute(place.move(0.05)))
        assert refused.outcome is Outcome.REFUSED
        assert "enable" in refused.message
        assert (await place.arm.order(Order.ENABLE)).done
        await place.until(lambda: place.arm.state.mode is Mode.HOLDING)
        await place.until(lambda: abs(place.held() - place.at()) < STILL_RAD)
