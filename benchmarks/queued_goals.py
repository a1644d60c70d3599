"""Rest of the arm between a goal and the next one in the queue, planned ahead and planned in its turn."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.planning import BLOCKED_LINES
from harness.figures import percentiles, print_table
from planners.goals import JointGoal
from planners.pool import PlannerPool
from planners.problem import MoveItErrorCode, PlanningProblem
from robot.arm import Arm
from robot.calibration import Calibration
from robot.description.limits import within_calibration
from robot.description.model import RobotModel
from robot.description.robot_folder import built_in
from robot.hardware.config import EmulatedConfig
from robot.messages import ArmConfig, MotionEnded
from robot.trajectory import Trajectory
from server.execution.executor import ExecutionContext, GoalExecutor, GoalExecutors
from server.execution.goal import Answer, Goal, GoalPolicy, GoalRequest
from server.execution.monitors import CurrentState
from server.execution.motions import PlannedMotion
from server.execution.queue import GoalQueue
from server.moveit.scene.scene_state import SceneState

STARTING_TIMEOUT_S = 30.0
ROUNDS = 2
GOALS = 16

SIMPLE = ((0.3, -0.2, 0.2, 0.1, 0.0), (-0.2, 0.2, 0.0, -0.1, 0.2))
# Between these, one after the other and from the last to the first, straight lines lead through the arm itself.
FOLDED = (BLOCKED_LINES[0][0], BLOCKED_LINES[2][1], BLOCKED_LINES[1][1], BLOCKED_LINES[2][1])


class TimedArm(Arm):
    """Arm that keeps when its motions began and ended."""

    gaps_s: list[float]  # times from the end of each motion to the beginning of the next [s]
    _ended_s: float | None = None

    def execute(
        self,
        trajectory: Trajectory,
        *,
        gripping: bool = False,
        torque_share: float = 1.0,
        continues: tuple[asyncio.Future[MotionEnded], float] | None = None,
        epoch: int | None = None,
    ) -> asyncio.Future[MotionEnded]:
        """Keep the time since the motion before."""
        loop = asyncio.get_running_loop()
        if self._ended_s is not None:
            self.gaps_s.append(loop.time() - self._ended_s)
        ended = super().execute(
            trajectory, gripping=gripping, torque_share=torque_share, continues=continues, epoch=epoch
        )
        ended.add_done_callback(lambda _: setattr(self, "_ended_s", loop.time()))
        return ended

    def begin_round(self) -> None:
        """Forget the motion before, and the times."""
        self.gaps_s, self._ended_s = [], None


class InTurnExecutor(GoalExecutor):
    """Executor that plans every goal in its turn."""

    def plan_ahead(self, following: Goal, left_s: float) -> None:
        """Plan nothing."""


@dataclass
class Figures:
    """Figures of all rounds: gaps [s], durations of the motions as planned [s], and how many were planned ahead."""

    gaps_s: list[float] = field(default_factory=list)
    durations_s: list[float] = field(default_factory=list)
    ahead: int = 0


def run() -> None:
    """Send bursts of goals, those that are planned ahead and those that are not by turns."""
    asyncio.run(_measure())


async def _measure() -> None:
    so101 = built_in("so101")
    calibration = replace(Calibration.nominal(so101.hardware.servos), measured=True)
    robot = within_calibration(so101.model, calibration)
    arm, pool = TimedArm(ArmConfig(robot, EmulatedConfig(calibration)), lambda _state: None), PlannerPool(robot)
    await arm.start(STARTING_TIMEOUT_S)
    await pool.start()
    rows: list[list[str]] = []
    try:
        for title, poses in (("straight", SIMPLE), ("searched", FOLDED)):
            ahead, in_turn = Figures(), Figures()
            for _ in range(ROUNDS):
                await _round(arm, robot, pool, poses, GoalExecutor, ahead)
                await _round(arm, robot, pool, poses, InTurnExecutor, in_turn)
            rows += _rows(title, ahead, in_turn)
    finally:
        await arm.close()
        await pool.close()
    print_table(
        "From the end of a motion to the beginning of that of the next goal in the queue [ms]",
        ["motions", "planned", "goals", "of them ahead", "p50", "p99", "max", "duration of the motions, mean [s]"],
        rows,
    )


def _rows(title: str, ahead: Figures, in_turn: Figures) -> Iterator[list[str]]:
    for name, figures in (("ahead", ahead), ("in its turn", in_turn)):
        gaps = percentiles(figures.gaps_s, 50, 99, 100)
        yield [title, name, str(len(figures.gaps_s)), str(figures.ahead), *gaps, f"{np.mean(figures.durations_s):.3f}"]
    gap = np.percentile(ahead.gaps_s, 50) / np.percentile(in_turn.gaps_s, 50)
    duration = np.mean(ahead.durations_s) / np.mean(in_turn.durations_s)
    yield [title, "ratio ahead to in its turn", "", "", f"{gap:.2f}", "", "", f"{duration:.3f}"]


async def _round(
    arm: TimedArm,
    robot: RobotModel,
    pool: PlannerPool,
    poses: Sequence[tuple[float, ...]],
    kind: type[GoalExecutor],
    figures: Figures,
) -> None:
    """Send a burst of goals, and wait until all are reached."""
    answers, summaries = list[Answer](), set[str]()
    all_answered = asyncio.Event()
    context = ExecutionContext(robot, pool, SceneState(robot), CurrentState(arm, robot))

    def take_answer(_goal: Goal, answer: Answer) -> None:
        answers.append(answer)
        if len(answers) == GOALS:
            all_answered.set()

    queue: GoalQueue = GoalQueue(
        GoalExecutors(arm, context, kind),
        GoalPolicy.QUEUE,
        GOALS,
        lambda goal, progress: summaries.add(goal.goal_id) if "in advance" in progress.message else None,
        take_answer,
    )
    arm.begin_round()
    queue.start()
    for number in range(GOALS):
        queue.submit(GoalRequest("/goal", _goal(robot, poses[number % len(poses)])))
    await all_answered.wait()
    failed = [answer.message for answer in answers if answer.code is not MoveItErrorCode.SUCCESS]
    assert not failed, failed
    figures.gaps_s += arm.gaps_s
    # The first motion begins where the round before ended.
    figures.durations_s += [
        motion.duration_s for each in answers[1:] if each.performed for motion in each.performed.planned
    ]
    figures.ahead += len(summaries)


def _goal(robot: RobotModel, pose_rad: tuple[float, ...]) -> PlannedMotion:
    joints = robot.groups["arm"].joints
    goal = JointGoal(dict(zip(joints, pose_rad, strict=True)), tolerance_rad=0.05)
    return PlannedMotion((lambda start_rad: PlanningProblem("arm", start_rad, goal),), frozenset(joints))
