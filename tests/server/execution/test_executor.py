import asyncio
import gc
import os
import signal
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import pytest_asyncio

from harness.waiting import TIMEOUT_S, until
from planners.goals import JointGoal
from planners.interface import Planners
from planners.pool import PlannerPool
from planners.problem import (
    ConcurrencyQuestion,
    MoveItErrorCode,
    NearestGoalAnswer,
    NearestGoalQuestion,
    Plan,
    PlanningFailure,
    PlanningProblem,
    RecheckAnswer,
    RecheckQuestion,
)
from planners.scene import Scene
from robot.arm import Arm
from robot.description.limits import within_calibration
from robot.description.model import RobotModel
from robot.hardware.config import EmulatedConfig, HardwareConfig, SerialConfig
from robot.messages import ArmConfig, ArmState, Mode, MotionEnded, Outcome
from robot.trajectory import Trajectory
from server.execution.executor import MAX_SAMPLES, ExecutionContext, GoalExecutor, MotionRecorder
from server.execution.failures import FailedGoals
from server.execution.goal import ExecutionDeadline, Goal, GoalRequest, GoalState, Progress, TimeLimits
from server.execution.monitors import CurrentState
from server.execution.motions import STATE_AGE_S, ExternalTrajectory, PathTime, PlannedMotion, Positions, SplicePoint
from server.execution.player import MotionsInProgress
from server.moveit.scene.scene_state import SceneState
from tests.helpers.clock import FakeClock
from tests.helpers.fake_arm import FakeArm, settle
from tests.helpers.motions import smooth_move
from tests.helpers.robots import nominal_calibration, so101
from tests.helpers.steps import StepOf

ARM = so101().groups["arm"].joints

STATE = ArmState(5.0, Mode.MOVING, ("a", "b"), position_rad=np.array([0.1, 0.2]), velocity_rad_s=np.array([1.0, 2.0]))


def to(**positions_rad: float) -> PlannedMotion:
    """Move some joints as fast as they can."""

    def problem(start_rad: Positions) -> PlanningProblem:
        return PlanningProblem("arm", start_rad, JointGoal(positions_rad))

    return PlannedMotion((StepOf(problem),), frozenset(ARM))


@dataclass
class Rig:
    """A motion on the real arm process, with emulated servos, and real planners."""

    arm: Arm
    pool: Planners
    executor: GoalExecutor
    news: list[Progress] = field(default_factory=list)

    async def run(self, **positions_rad: float) -> Any:
        self.goal = Goal("1", GoalRequest("/goal", to(**positions_rad)), self.news.append)
        return await self.executor.run(self.goal)


def context_of(arm: Arm, robot: RobotModel, pool: Planners) -> ExecutionContext:
    return ExecutionContext(robot, pool, SceneState(robot), CurrentState(arm, robot))


def executor_of(arm: Arm, robot: RobotModel, pool: Planners) -> GoalExecutor:
    return GoalExecutor(arm, context_of(arm, robot, pool), MotionsInProgress())


# Planners load for a second: one arm and its planners serve all tests of the rig, and so show that they survive each.
in_one_loop = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def processes() -> AsyncIterator[tuple[Arm, Planners, RobotModel]]:
    calibration = nominal_calibration()
    robot = within_calibration(so101(), calibration)
    arm = Arm(ArmConfig(robot, EmulatedConfig(calibration)), lambda _state: None)
    await arm.start(TIMEOUT_S)
    pool = PlannerPool(robot)
    await pool.start()
    yield arm, pool, robot
    await arm.close()
    await pool.close()


@pytest.fixture
def rig(processes: tuple[Arm, Planners, RobotModel]) -> Rig:
    arm, pool, robot = processes
    return Rig(arm, pool, executor_of(arm, robot, pool))


@in_one_loop
async def test_a_motion_is_planned_played_and_reported(rig: Rig) -> None:
    answer = await rig.run(shoulder_pan=0.8)
    assert answer.code is MoveItErrorCode.SUCCESS
    states = [progress.state for progress in rig.news]
    assert states[:2] == [GoalState.PLANNING, GoalState.EXECUTING]
    fractions = [progress.fraction for progress in rig.news]
    assert fractions == sorted(fractions)


@in_one_loop
async def test_a_stop_ends_planning_that_hangs(rig: Rig) -> None:
    await rig.run(shoulder_pan=0.01)
    hanging = rig.pool.pids
    for pid in hanging:
        os.kill(pid, signal.SIGSTOP)
    rig.news.clear()
    running = asyncio.create_task(rig.run(shoulder_pan=0.8))
    await until(lambda: rig.news)
    rig.goal.cancel("stopped by a test")
    answer = await asyncio.wait_for(running, TIMEOUT_S)
    for pid in set(hanging) & set(rig.pool.pids):
        os.kill(pid, signal.SIGCONT)
    assert answer.code is MoveItErrorCode.PREEMPTED
    assert answer.message == "stopped by a test while planning"


@in_one_loop
@pytest.mark.parametrize("state", [GoalState.PLANNING, GoalState.EXECUTING])
async def test_a_stop_at_any_moment_is_answered_and_leaves_the_arm_holding(rig: Rig, state: GoalState) -> None:
    await rig.run(shoulder_pan=0.01)
    rig.news.clear()
    running = asyncio.create_task(rig.run(shoulder_pan=1.5))
    await until(lambda: any(progress.state is state for progress in rig.news))
    rig.goal.cancel("stopped by a test")
    answer = await asyncio.wait_for(running, TIMEOUT_S)
    assert answer.code is MoveItErrorCode.PREEMPTED
    await until(lambda: rig.arm.state.mode is Mode.HOLDING)
    assert (await rig.run(shoulder_pan=0.0)).code is MoveItErrorCode.SUCCESS


async def test_an_arm_that_is_not_connected_plans_nothing() -> None:
    robot = so101()
    arm = Arm(ArmConfig(robot, SerialConfig(nominal_calibration(), "/dev/nothing")), lambda _state: None)
    executor = executor_of(arm, robot, PlannerPool(robot))
    answer = await executor.run(Goal("1", GoalRequest("/goal", to(shoulder_pan=0.5))))
    assert answer.code is MoveItErrorCode.COMMUNICATION_FAILURE
    assert "starting" in answer.message


@pytest.mark.parametrize(
    "hardware", [SerialConfig(nominal_calibration(), "/dev/nothing"), EmulatedConfig(nominal_calibration())]
)
def test_the_scene_monitor_waits_for_planners_as_long_as_for_the_arm(hardware: HardwareConfig) -> None:
    robot = so101()
    arm = Arm(ArmConfig(robot, hardware), lambda _state: None)
    executor = executor_of(arm, robot, PlannerPool(robot))
    assert executor._scene_monitor._retry_for_s == arm.state_max_age_s


WALL = PlanningFailure(MoveItErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE, "would touch the wall")
NO_WAY = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "there is no way")
OUT_OF_REACH = PlanningFailure(MoveItErrorCode.NO_IK_SOLUTION, "too far", {"distance_m": 0.2})


class Stage:
    """An arm without a process, a scene, and planners that answer what they are told to."""

    def __init__(self) -> None:
        self.arm, self.clock = FakeArm(), FakeClock()
        self.scene = Scene(1)
        self.failures: list[PlanningFailure] = []
        self.planners_answer = asyncio.Event()
        self.planners_answer.set()
        self.contact: PlanningFailure | None = None
        self.problems: list[PlanningProblem] = []
        self.scenes: list[int] = []
        self.rechecked: list[RecheckQuestion] = []
        self.recheck_s = 0.0
        self.meeting: PlanningFailure | None = None
        self.meetings: list[ConcurrencyQuestion] = []
        self.meetings_answer = asyncio.Event()
        self.meetings_answer.set()
        self.in_progress = MotionsInProgress()
        self.news: list[Progress] = []
        self.executor = self.executing()
        self.running: asyncio.Task[Any] | None = None

    def executing(self, failed_goals: FailedGoals | None = None) -> GoalExecutor:
        return GoalExecutor(self.arm.as_arm, self.context(failed_goals=failed_goals), self.in_progress)

    def context(self, **parts: Any) -> ExecutionContext:
        """The parts of the executors, in the time of the stage."""
        current = CurrentState(self.arm, so101())
        return ExecutionContext(so101(), cast("Planners", self), self, current, clock=self.clock, **parts)

    def on_change(self, callback: Callable[[], None]) -> None:
        self.changed = callback

    async def ask(self, request: Any, scene: Scene) -> Any:
        if isinstance(request, RecheckQuestion):
            self.rechecked.append(request)
            self.clock.advance(self.recheck_s)
            return RecheckAnswer(self.contact)
        if isinstance(request, ConcurrencyQuestion):
            self.meetings.append(request)
            await self.meetings_answer.wait()
            return RecheckAnswer(self.meeting)
        if isinstance(request, NearestGoalQuestion):
            return NearestGoalAnswer(None)
        self.problems.append(request)
        self.scenes.append(scene.version)
        await self.planners_answer.wait()
        if self.failures:
            return self.failures.pop(0)
        ends = {**request.start_rad, **request.goal.positions_rad}
        moves = {name: (request.start_rad[name], ends[name]) for name in ARM}
        still = all(start_rad == end_rad for start_rad, end_rad in moves.values())
        return Plan(standing(moves) if still else smooth_move(moves, 1.0), "straight line", 0.01)

    async def begin(self, motion: PlannedMotion | ExternalTrajectory, limits: TimeLimits | None = None) -> None:
        self.goal = Goal("1", GoalRequest("/goal", motion), self.news.append, deadline=ExecutionDeadline(limits))
        self.running = asyncio.create_task(self.executor.run(self.goal))
        await settle()

    async def answer(self) -> Any:
        assert self.running is not None
        return await asyncio.wait_for(self.running, TIMEOUT_S)

    async def arrive(self) -> None:
        """Have the arm reach the end of its motion, and the goal its own."""
        self.arm.end()
        assert (await self.answer()).code is MoveItErrorCode.SUCCESS


def standing(moves: Mapping[str, tuple[float, float]]) -> Trajectory:
    """A motion that takes no time."""
    still = np.zeros((1, len(moves)))
    return Trajectory(tuple(moves), np.zeros(1), np.array([[start for start, _ in moves.values()]]), still, still)


@pytest.fixture
async def stage() -> Stage:
    return Stage()


def given(start_rad: float, end_rad: float) -> ExternalTrajectory:
    motion = smooth_move(dict.fromkeys(ARM, (start_rad, end_rad)), 2.0)
    return ExternalTrajectory(lambda *_start: motion, frozenset(ARM))


TOO_LONG = "the duration of the {} s, longer than goals.max_trajectory_duration_s = 0.9{}"


async def test_a_motion_that_takes_too_long_is_refused_and_not_planned_again(stage: Stage) -> None:
    for motion, code, words in (
        (
            replace(to(shoulder_pan=0.4), attempts=5),
            MoveItErrorCode.FAILURE,
            ("planned motion is 1", ": raise the velocity and acceleration scaling"),
        ),
        (given(0.0, 0.2), MoveItErrorCode.INVALID_MOTION_PLAN, ("trajectory is 2", "")),
    ):
        await stage.begin(motion, TimeLimits(trajectory_s=0.9))
        answer = await stage.answer()
        assert (answer.code, answer.message) == (code, TOO_LONG.format(*words))
    assert (len(stage.problems), stage.arm.played) == (1, [])


@pytest.mark.parametrize("version", [0, 1])
async def test_a_given_trajectory_is_checked_before_it_begins_in_an_unchanged_scene(stage: Stage, version: int) -> None:
    stage.scene, stage.contact = Scene(version), WALL
    await stage.begin(given(0.0, 0.2))
    assert (await stage.answer()).code is WALL.code
    assert stage.arm.played == []


async def test_a_goal_that_comes_while_the_arm_is_being_started_waits_for_it(stage: Stage) -> None:
    stage.arm.started.clear()
    await stage.begin(to(shoulder_pan=0.4))
    assert not stage.problems
    stage.arm.started.set()
    await settle()
    await stage.arrive()


async def test_a_goal_that_is_stopped_while_the_arm_is_being_started_moves_nothing(stage: Stage) -> None:
    stage.arm.started.clear()
    await stage.begin(given(0.0, 0.4))
    stage.goal.cancel("stopped by a test")
    answer = await stage.answer()
    assert (answer.code, answer.message) == (MoveItErrorCode.PREEMPTED, "stopped by a test before the motion began")
    assert not stage.arm.played


async def test_a_goal_out_of_reach_is_not_planned_again(stage: Stage) -> None:
    stage.failures = [OUT_OF_REACH]
    await stage.begin(replace(to(shoulder_pan=0.4), attempts=5))
    answer = await stage.answer()
    assert (answer.code, answer.message, answer.details) == (OUT_OF_REACH.code, "too far", {"distance_m": 0.2})
    assert len(stage.problems) == 1


@pytest.mark.parametrize(
    ("failures", "attempts", "tried"), [(1, 3, 2), (9, 3, 3), (9, 2, 2)], ids=["then there is a way", "never", "of two"]
)
async def test_planning_is_repeated_up_to_the_limit(stage: Stage, failures: int, attempts: int, tried: int) -> None:
    stage.failures = [NO_WAY] * failures
    await stage.begin(replace(to(shoulder_pan=0.4), attempts=attempts))
    stage.arm.end()
    await stage.answer()
    assert len(stage.problems) == tried


async def test_a_motion_that_the_scene_stops_is_planned_again_from_the_present_position(stage: Stage) -> None:
    await stage.begin(replace(to(shoulder_pan=0.4), attempts=2))
    stage.contact, stage.scene = WALL, Scene(2)
    stage.arm.put(shoulder_pan=0.2)
    stage.changed()
    await settle()
    stage.contact = None
    await stage.arrive()
    assert [problem.start_rad["shoulder_pan"] for problem in stage.problems] == [0.0, 0.2]
    assert stage.scenes == [1, 2]


async def test_a_scene_that_changes_during_planning_is_checked_before_the_motion(stage: Stage) -> None:
    def change(start_rad: Positions) -> PlanningProblem:
        stage.scene, stage.contact = Scene(2), WALL
        return PlanningProblem("arm", start_rad, JointGoal({"shoulder_pan": 0.4}))

    await stage.begin(PlannedMotion((StepOf(change),), frozenset(ARM)))
    assert (await stage.answer()).code is WALL.code
    assert stage.arm.played == []


async def test_a_goal_is_planned_again_when_the_arm_was_moved_meanwhile(stage: Stage) -> None:
    def move(start_rad: Positions) -> PlanningProblem:
        stage.arm.put(shoulder_pan=0.3)
        return PlanningProblem("arm", start_rad, JointGoal({"shoulder_pan": 0.4}))

    await stage.begin(PlannedMotion((StepOf(move),), frozenset(ARM)))
    await stage.arrive()
    assert stage.arm.played[0].positions_rad[0, 0] == 0.3


async def test_an_external_trajectory_is_checked_and_played_from_where_the_arm_holds(stage: Stage) -> None:
    stage.arm.put(shoulder_pan=0.02)
    await stage.begin(given(0.0, 0.5))
    await stage.arrive()
    assert stage.arm.played[0].positions_rad[0, 0] == 0.02
    assert stage.rechecked[0].trajectory is stage.arm.played[0]
    assert set(stage.rechecked[0].others_rad) == {"gripper"}


async def test_an_external_trajectory_that_starts_elsewhere_is_not_played(stage: Stage) -> None:
    await stage.begin(given(0.3, 0.5))
    assert (await stage.answer()).code is MoveItErrorCode.CONTROL_FAILED
    assert stage.arm.played == []


async def test_a_steered_arm_has_to_come_to_rest_first(stage: Stage) -> None:
    stage.arm.steered = True
    await stage.begin(to(shoulder_pan=0.4))
    answer = await stage.answer()
    assert answer.code is MoveItErrorCode.CONTROL_FAILED
    assert "being steered" in answer.message


async def test_a_goal_cancelled_before_its_work_begins_moves_nothing_and_the_next_one_moves(stage: Stage) -> None:
    goal = Goal("1", GoalRequest("/goal", to(shoulder_pan=0.4)))
    goal.cancel("ended by a test")
    answer = await stage.executor.run(goal)
    assert (answer.code, answer.message) == (MoveItErrorCode.PREEMPTED, "ended by a test before the motion began")
    assert stage.arm.played == []
    await stage.begin(to(shoulder_pan=0.4))
    await stage.arrive()


async def test_only_a_goal_that_could_not_be_planned_is_saved(stage: Stage, tmp_path: Path) -> None:
    stage.executor = stage.executing(FailedGoals(tmp_path, so101(), lambda: 0.0, 1))
    stage.failures = [NO_WAY]
    for _ in range(2):
        await stage.begin(to(shoulder_pan=0.4))
        await until(lambda: stage.running.done() or stage.arm.played)
        stage.arm.end()
        await stage.answer()
    assert [name for name in os.listdir(tmp_path) if name.endswith(".json")] == [  # noqa: PTH208
        "goal-19700101T000000.000000Z-PLANNING_FAILED.json"
    ]


async def under_way(stage: Stage) -> None:
    """Let a motion be seen half done, give way, and its answer come."""
    await stage.begin(to(shoulder_pan=0.4))
    stage.clock.advance(2.0 * STATE_AGE_S)
    stage.arm.pass_time(2.0 * STATE_AGE_S)
    stage.arm.show(0.5)
    stage.goal.cancel("preempted by a test", replaced=True)
    assert (await stage.answer()).message == "preempted by a test"


async def test_a_goal_replaces_the_motion_of_the_preempted_goal_without_a_stop(stage: Stage) -> None:
    await under_way(stage)
    await stage.begin(to(shoulder_pan=-0.2))
    stage.arm.end()
    answer = await stage.answer()
    assert answer.code is MoveItErrorCode.SUCCESS
    assert stage.arm.stops == []
    former, whole = stage.arm.played
    from_s = stage.arm.continued[0]
    np.testing.assert_allclose(whole.sample(0.1)[0], former.sample(from_s + 0.1)[0], atol=1e-9)
    assert stage.problems[-1].start_velocity_rad_s["shoulder_pan"] > 0.0
    assert answer.performed.planned == (whole,)


async def test_states_are_no_more_recorded_once_a_motion_of_a_stream_has_ended(stage: Stage) -> None:
    await under_way(stage)
    await stage.begin(to(shoulder_pan=-0.2))
    stage.goal.request = replace(stage.goal.request, streamed=True, repeated=True)
    await stage.arrive()
    stage.executor.recorder.take_state(STATE)
    assert stage.executor.recorder.finish(("a",)) is None


async def test_a_goal_whose_motion_takes_too_long_replaces_no_motion(stage: Stage) -> None:
    await under_way(stage)
    await stage.begin(to(shoulder_pan=-0.2), TimeLimits(trajectory_s=0.9))
    answer = await stage.answer()
    assert "longer than goals.max_trajectory_duration_s = 0.9" in answer.message
    assert len(stage.arm.played) == 1
    assert len(stage.arm.stops) >= 1


def be_nowhere_to_leave(stage: Stage) -> None:
    outgoing = stage.executor._player.outgoing
    assert outgoing is not None
    stage.executor._player.outgoing = replace(outgoing, path_time=PathTime(0.0, 0.0, 0.0))


@pytest.mark.parametrize("spliced", [True, False])
async def test_a_given_trajectory_replaces_the_motion_unless_it_begins_at_rest(stage: Stage, *, spliced: bool) -> None:
    await under_way(stage)

    def trajectory(_positions_rad: Positions, _at_s: float, point: SplicePoint | None) -> Trajectory:
        held_rad = stage.executor._held_rad() if point is None else point.positions_rad
        return smooth_move({name: (held_rad[name], held_rad[name] + 0.1) for name in ARM}, 1.0)

    await stage.begin(ExternalTrajectory(trajectory, frozenset(ARM), spliced=spliced))
    await until(lambda: len(stage.arm.played) == 2)
    stage.arm.end()
    assert (await stage.answer()).code is MoveItErrorCode.SUCCESS
    assert (stage.arm.stops == []) is spliced
    assert len(stage.arm.continued) == int(spliced)
    assert len(stage.rechecked) == 1


class Given:
    """A trajectory that continues where it is asked to; it knows when it was to begin, of each attempt."""

    def __init__(self, stage: Stage) -> None:
        self.stage, self.begins_s = stage, list[float]()

    def __call__(self, positions_rad: Positions, at_s: float, point: SplicePoint | None) -> Trajectory:
        self.begins_s.append(at_s)
        held_rad = positions_rad if point is None else point.positions_rad
        return smooth_move({name: (held_rad[name], held_rad[name] + 0.1) for name in ARM}, 1.0)


async def test_a_given_trajectory_changes_the_goals_within_15_ms_of_its_answer(stage: Stage) -> None:
    stage.recheck_s = 0.008
    await under_way(stage)
    for _ in range(2):
        trajectory, stage.news = Given(stage), []
        await stage.begin(ExternalTrajectory(trajectory, frozenset(ARM)))
        await until(lambda: any(each.state is GoalState.EXECUTING for each in stage.news))
        answered_s = stage.clock()
        stage.arm.show(0.2)
        stage.goal.cancel("preempted by a test", replaced=True)
        await stage.answer()
    # The arm's next tick is up to 10 ms later.
    assert 0.0 <= trajectory.begins_s[-1] - answered_s <= 0.005
    assert stage.arm.stops == []
    assert len(stage.arm.continued) == 2


@pytest.mark.parametrize("busy_s", [(0.1, 0.008), (0.016,)], ids=["a busy moment before", "a little late"])
async def test_a_check_in_a_busy_moment_does_not_delay_a_trajectory(stage: Stage, busy_s: tuple[float, ...]) -> None:
    await under_way(stage)
    for recheck_s in (0.008, 0.008, 0.008, *busy_s):
        stage.recheck_s, trajectory, stage.news = recheck_s, Given(stage), []
        await stage.begin(ExternalTrajectory(trajectory, frozenset(ARM)))
        await until(lambda: any(each.state is GoalState.EXECUTING for each in stage.news))
        stage.arm.show(0.2)
        stage.goal.cancel("preempted by a test", replaced=True)
        await stage.answer()
    assert trajectory.begins_s[-1] - stage.clock() <= 0.01
    assert len(trajectory.begins_s) == 1
    assert stage.arm.stops == []


async def test_listeners_hear_of_a_given_trajectory_when_the_arm_has_it(stage: Stage) -> None:
    await under_way(stage)
    heard: list[int] = []
    given = ExternalTrajectory(Given(stage), frozenset(ARM))
    goal = Goal("2", GoalRequest("/goal", given), lambda _progress: heard.append(len(stage.arm.played)))
    running = asyncio.create_task(stage.executor.run(goal))
    await until(lambda: heard)
    assert heard[0] == 2
    stage.arm.end()
    await running


@pytest.mark.parametrize("refusals", [1, 2, 3])
async def test_a_given_trajectory_that_the_arm_got_too_late_is_sent_again_twice(stage: Stage, refusals: int) -> None:
    stage.recheck_s = 0.008
    await under_way(stage)
    trajectory = Given(stage)

    def late(positions_rad: Positions, at_s: float, point: SplicePoint | None) -> Trajectory:
        stage.arm.refusing = len(trajectory.begins_s) < refusals
        return trajectory(positions_rad, at_s, point)

    await stage.begin(ExternalTrajectory(late, frozenset(ARM)))
    await until(lambda: len(stage.arm.played) == 2 + refusals)
    stage.arm.end()
    assert (await stage.answer()).code is MoveItErrorCode.SUCCESS
    assert (stage.arm.stops == []) is (refusals <= 2)
    assert len(trajectory.begins_s) == refusals + 1


OTHERWISE: dict[str, Callable[[Stage], object]] = {
    "planning takes too long": lambda stage: stage.planners_answer.clear(),
    "there is no such plan": lambda stage: stage.failures.append(NO_WAY),
    "the arm has left the place": lambda stage: setattr(stage.arm, "refusing", True),
    "the arm goes back": be_nowhere_to_leave,
}


@pytest.mark.parametrize("obstacle", OTHERWISE.values(), ids=OTHERWISE.keys())
async def test_the_arm_brakes_for_a_motion_it_cannot_blend(stage: Stage, obstacle: Callable[[Stage], object]) -> None:
    await under_way(stage)
    obstacle(stage)
    await stage.begin(to(shoulder_pan=-0.2))
    await until(lambda: stage.arm.stops)
    stage.planners_answer.set()
    await until(lambda: stage.arm.state.mode is Mode.MOVING)
    await stage.arrive()
    assert stage.arm.continued == []


async def test_a_goal_that_is_cancelled_before_the_replacement_leaves_the_arm_at_rest(stage: Stage) -> None:
    await under_way(stage)
    stage.planners_answer.clear()
    await stage.begin(to(shoulder_pan=-0.2))
    stage.goal.cancel("cancelled by a test")
    assert (await stage.answer()).code is MoveItErrorCode.PREEMPTED
    assert stage.arm.stops


async def test_a_goal_that_is_cancelled_as_its_replacement_is_to_be_planned_asks_no_planner(stage: Stage) -> None:
    await under_way(stage)
    asked = len(stage.problems)

    def report(progress: Progress) -> None:
        if progress.message == "planning in motion":
            goal.cancel("cancelled by a test")

    goal = Goal("2", GoalRequest("/goal", to(shoulder_pan=-0.2)), report)
    answer = await asyncio.wait_for(stage.executor.run(goal), TIMEOUT_S)
    # A question that is never awaited is an error of the test run.
    gc.collect()
    assert answer.code is MoveItErrorCode.PREEMPTED
    assert len(stage.problems) == asked


def test_a_recording_is_a_trajectory_from_time_0() -> None:
    recorder = MotionRecorder()
    recorder.take_state(STATE)
    recorder.start()
    # Its times are of the arm's clock, though the machine's is set meanwhile.
    for clock_s, stamp_s in ((6.0, 1e9), (6.5, 1e9 - 3600.0), (6.5, 2e9)):
        recorder.take_state(replace(STATE, clock_s=clock_s, stamp_s=stamp_s))
    way = recorder.finish(("b",))
    assert way is not None
    assert way.time_s.tolist() == [0.0, 0.5]
    assert way.positions_rad.tolist() == [[0.2], [0.2]]
    assert way.velocities_rad_s.tolist() == [[2.0], [2.0]]


def test_a_recording_is_bounded() -> None:
    recorder = MotionRecorder()
    recorder.start()
    for number in range(MAX_SAMPLES + 10):
        recorder.take_state(replace(STATE, clock_s=float(number)))
    way = recorder.finish(("a",))
    assert way is not None
    assert way.duration_s == MAX_SAMPLES - 1


FINGER = smooth_move({"gripper": (0.0, 0.7)}, 1.0)
MIGHT_TOUCH = PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, "the finger may touch the arm")


def beside(stage: Stage) -> asyncio.Future[MotionEnded]:
    """Have the gripper move for another goal; returns the end of its motion."""
    ended: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
    stage.in_progress.add(FINGER, ended)
    return ended


async def test_a_motion_waits_for_one_that_it_may_touch_and_says_so(stage: Stage) -> None:
    ended, stage.meeting = beside(stage), MIGHT_TOUCH
    await stage.begin(to(shoulder_pan=0.4))
    assert stage.arm.played == []
    assert stage.news[-1] == Progress(GoalState.PLANNED, "waits for the motion of gripper, which it might touch")
    ended.set_result(MotionEnded(1, Outcome.REACHED, "there"))
    await settle()
    assert len(stage.arm.played) == 1


async def test_a_goal_that_waits_for_a_motion_can_be_cancelled(stage: Stage) -> None:
    beside(stage)
    stage.meeting = MIGHT_TOUCH
    await stage.begin(to(shoulder_pan=0.4))
    stage.goal.cancel("enough")
    assert (await stage.answer()).code is MoveItErrorCode.PREEMPTED
    assert stage.arm.played == []


async def test_a_motion_is_checked_anew_where_the_one_that_it_waited_for_stopped_elsewhere(stage: Stage) -> None:
    ended, stage.meeting = beside(stage), MIGHT_TOUCH
    await stage.begin(to(shoulder_pan=0.4))
    stage.arm.put(gripper=0.3)
    ended.set_result(MotionEnded(1, Outcome.STOPPED, "stopped"))
    await settle()
    assert [question.others_rad for question in stage.rechecked] == [{"gripper": 0.3}]


async def test_the_monitor_asks_about_motions_beside_as_well(stage: Stage) -> None:
    await stage.begin(to(shoulder_pan=0.4))
    beside(stage)
    stage.meeting = MIGHT_TOUCH
    stage.scene = Scene(2)
    stage.changed()
    await settle()
    assert (await stage.answer()).message.startswith("the finger may touch the arm")


async def test_a_motion_of_a_preempted_goal_of_another_group_is_braked_first(stage: Stage) -> None:
    outgoing = stage.arm.execute(smooth_move({"shoulder_pan": (0.0, 0.5)}, 1.0))
    stage.in_progress.add(smooth_move({"shoulder_pan": (0.0, 0.5)}, 1.0), outgoing)
    await stage.begin(to(shoulder_pan=0.4))
    assert stage.arm.stops == [outgoing]
    assert len(stage.arm.played) == 2


async def test_a_goal_is_planned_after_those_that_came_before_for_where_they_end(stage: Stage) -> None:
    """Its group may have no place yet where the motion of the other, still being planned, makes room."""
    stage.planners_answer.clear()
    await stage.begin(to(shoulder_pan=0.4))
    other = stage.executing()
    second = asyncio.create_task(other.run(Goal("2", GoalRequest("/goal", fingers()))))
    await settle()
    assert len(stage.problems) == 1
    stage.planners_answer.set()
    await settle()
    assert stage.problems[1].start_rad["shoulder_pan"] == pytest.approx(0.4)
    second.cancel()


async def test_a_motion_that_was_announced_and_not_begun_is_forgotten(stage: Stage) -> None:
    await stage.begin(replace(to(shoulder_pan=0.4), confirm=True))
    stage.goal.cancel("enough")
    await stage.answer()
    await stage.begin(fingers())
    assert stage.problems[-1].start_rad["shoulder_pan"] == 0.0


def fingers() -> PlannedMotion:
    """Move the joints of another group."""

    def problem(start_rad: Positions) -> PlanningProblem:
        return PlanningProblem("gripper", start_rad, JointGoal({"gripper": 0.5}))

    return PlannedMotion((StepOf(problem),), frozenset(("gripper",)))


async def test_a_motion_that_begins_during_the_last_check_is_checked_as_well(stage: Stage) -> None:
    first = beside(stage)
    stage.meetings_answer.clear()
    await stage.begin(to(shoulder_pan=0.4))
    first.set_result(MotionEnded(1, Outcome.REACHED, "there"))
    beside(stage)
    stage.meetings_answer.set()
    await settle()
    assert len(stage.meetings) == 2
    assert len(stage.arm.played) == 1
