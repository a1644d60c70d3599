from __future__ import annotations

import asyncio
import math
import os
import signal
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from planners.goals import JointGoal
from planners.pool import PlannerPool
from planners.problem import MoveItErrorCode
from robot import model
from robot.arm import Arm
from robot.calibration import Calibration
from robot.limits import within_calibration
from robot.messages import ArmConfig, ArmState, Mode
from server.config import EmulatorSettings
from server.emulated_bus import EmulatedBus
from server.goal_queue import GoalState, Progress
from server.moveit.execution import GoalExecutor
from server.moveit.failed_goals import FailedGoals
from server.moveit.goals import MotionRequest
from server.moveit.parameters import MoveItParameters
from server.moveit.readiness import STATE_MAX_AGE_S


@dataclass
class Rig:
    """A motion on the real arm process and real planners, on the emulated bus."""

    arm: Arm
    pool: PlannerPool
    executor: GoalExecutor
    states: list[ArmState]
    news: list[Progress] = field(default_factory=list)

    async def run(self, **positions_rad: float) -> Any:
        # While other tests' processes start, this one may not have been given its turn to read.
        await self.until(lambda: self.arm.state_age_s < STATE_MAX_AGE_S)
        return await self.executor.run(MotionRequest(JointGoal(positions_rad)), self.news.append)

    async def until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(10.0):
            while not condition():
                await asyncio.sleep(0.005)


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    calibration = Calibration.nominal()
    robot = within_calibration(model.builtin(), calibration)
    bus = EmulatedBus(EmulatorSettings(), None)
    states: list[ArmState] = []
    arm = Arm(ArmConfig(robot, calibration, await bus.start()), states.append)
    await arm.start(10.0)
    pool = PlannerPool(robot)
    await pool.start()
    parameters = MoveItParameters(max_velocity_scaling=1.0, max_acceleration_scaling=1.0)
    yield Rig(arm, pool, GoalExecutor(arm, pool, parameters), states)
    await arm.close()
    await pool.close()
    await bus.close()


async def test_a_motion_is_planned_played_and_told(rig: Rig) -> None:
    answer = await rig.run(shoulder_pan=0.8)
    assert answer.code is MoveItErrorCode.SUCCESS
    states = [progress.state for progress in rig.news]
    assert states[:2] == [GoalState.PLANNING, GoalState.EXECUTING]
    fractions = [progress.fraction for progress in rig.news]
    assert fractions == sorted(fractions)


async def test_a_goal_where_the_arm_is_moves_nothing(rig: Rig) -> None:
    goal = dict(zip(rig.arm.state.joint_names, rig.arm.state.goal_rad.tolist(), strict=True))  # type: ignore[union-attr]
    del goal["gripper"]
    assert (await rig.run(**goal)).message == "the arm was there already"
    assert all(state.mode is not Mode.MOVING for state in rig.states)


async def test_a_stop_while_planning_is_answered_with_its_reason(rig: Rig) -> None:
    await rig.run(shoulder_pan=0.01)
    running = asyncio.create_task(rig.run(shoulder_pan=0.8))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    rig.executor.stop("stopped by a test")
    answer = await running
    assert answer.code is MoveItErrorCode.PREEMPTED
    assert answer.message.startswith("stopped by a test")


async def test_a_stop_ends_planning_that_hangs(rig: Rig) -> None:
    await rig.run(shoulder_pan=0.01)
    for pid in rig.pool.pids:
        os.kill(pid, signal.SIGSTOP)
    running = asyncio.create_task(rig.run(shoulder_pan=0.8))
    await asyncio.sleep(0.05)
    rig.executor.stop("stopped by a test")
    answer = await asyncio.wait_for(running, 2.0)
    assert answer.code is MoveItErrorCode.PREEMPTED
    assert answer.message == "stopped by a test while planning"


@pytest.mark.parametrize("delay_s", [0.005, 0.01, 0.015, 0.02, 0.03, 0.3])
async def test_a_stop_at_any_moment_is_answered_and_leaves_the_arm_holding(rig: Rig, delay_s: float) -> None:
    await rig.run(shoulder_pan=0.01)
    running = asyncio.create_task(rig.run(shoulder_pan=1.5))
    await asyncio.sleep(delay_s)
    rig.executor.stop("stopped by a test")
    answer = await asyncio.wait_for(running, 3.0)
    assert answer.code is MoveItErrorCode.PREEMPTED
    await rig.until(lambda: rig.arm.state.mode is Mode.HOLDING)
    assert (await rig.run(shoulder_pan=0.0)).code is MoveItErrorCode.SUCCESS


async def test_an_arm_that_is_not_connected_plans_nothing() -> None:
    robot = model.builtin()
    arm = Arm(ArmConfig(robot, Calibration.nominal(), "/dev/nothing"), lambda _state: None)
    executor = GoalExecutor(arm, PlannerPool(robot), MoveItParameters())
    answer = await executor.run(MotionRequest(JointGoal({"shoulder_pan": 0.5})), lambda _progress: None)
    assert answer.code is MoveItErrorCode.COMMUNICATION_FAILURE
    assert "starting" in answer.message


async def test_only_a_goal_that_could_not_be_planned_is_saved(rig: Rig, tmp_path: Path) -> None:
    failed_goals = FailedGoals(tmp_path, model.builtin(), lambda: 0.0)
    rig.executor = GoalExecutor(rig.arm, rig.pool, MoveItParameters(max_velocity_scaling=1.0), failed_goals)
    assert (await rig.run(shoulder_pan=0.01)).code is MoveItErrorCode.SUCCESS
    answer = await rig.run(shoulder_lift=math.nan)
    assert os.listdir(tmp_path) == [f"goal-19700101T000000.000000Z-{answer.code.name}.json"]  # noqa: PTH208
