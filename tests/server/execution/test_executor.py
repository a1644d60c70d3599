import asyncio
import functools
import gc
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias, cast
from unittest.mock import AsyncMock

import numpy as np
import pytest

from harness.waiting import TIMEOUT_S, until
from planners.goals import JointGoal
from planners.interface import Planners
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
from robot.messages import Mode, MotionEnded, Outcome, Pace, PlaybackDirection
from robot.trajectory import PERIOD_S, Trajectory
from server.execution import executor as execution
from server.execution.confirmation import Confirmation
from server.execution.executor import ExecutionContext, GoalExecutor
from server.execution.goal import ExecutionDeadline, Goal, GoalRequest, GoalState, Progress, TimeLimits
from server.execution.monitors import CurrentScene, CurrentState
from server.execution.motions import (
    OUTGOING_S,
    SENDING_S,
    STATE_AGE_S,
    TICK_LATE_S,
    ExternalTrajectory,
    MotionsInProgress,
    PathTime,
    PlannedMotion,
    Positions,
    SplicePoint,
)
from server.graph.topics import Graph
from tests.helpers.clock import FakeClock
from tests.helpers.fake_arm import FakeArm, StubbornArm, settle
from tests.helpers.motions import STILL, smooth_move
from tests.helpers.moveit import REGISTRY
from tests.helpers.robots import so101

Motion: TypeAlias = PlannedMotion | ExternalTrajectory

ARM = so101().groups["arm"].joints


def to(group: str = "arm", **positions_rad: float) -> PlannedMotion:
    """Move some joints of a group as fast as they can."""
    step = functools.partial(PlanningProblem, group, goal=JointGoal(positions_rad))
    return PlannedMotion((step,), frozenset(so101().groups[group].joints))


INVALIDATED = MoveItErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE
WALL = PlanningFailure(INVALIDATED, "would touch the wall", {"pairs": ["wall"]})
NO_WAY = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "there is no way")
OUT_OF_REACH = PlanningFailure(MoveItErrorCode.NO_IK_SOLUTION, "too far", {"distance_m": 0.2})


class Stage(CurrentScene):
    """An arm without a process, a scene, and planners that answer what they are told to."""

    def __init__(self, arm: FakeArm | None = None) -> None:
        super().__init__()
        self.arm, self.clock = arm or FakeArm(), FakeClock()
        self.scene = Scene(1)
        self.meanwhile: Callable[[], object] = lambda: None
        self.failures: list[PlanningFailure] = []
        self.planners_answer, self.checks_answer = asyncio.Event(), asyncio.Event()
        self.planners_answer.set()
        self.checks_answer.set()
        self.contact: PlanningFailure | None = None
        self.late: PlanningFailure | None = None
        self.meeting: PlanningFailure | None = None
        self.recheck_s, self.plan_s = 0.0, 1.0
        self.problems: list[PlanningProblem] = []
        self.scenes: list[int] = []
        self.rechecked: list[RecheckQuestion] = []
        self.checked_in: list[int] = []
        self.meetings: list[ConcurrencyQuestion] = []
        self.in_progress = MotionsInProgress()
        self.news: list[Progress] = []
        self.executor = self.executing()
        self.running: asyncio.Task[Any] | None = None

    def executing(self, **parts: Any) -> GoalExecutor:
        """An executor in the time of the stage."""
        current = CurrentState(self.arm)
        gate = Confirmation(Graph(REGISTRY), enabled=False, timeout_s=TIMEOUT_S)
        context = ExecutionContext(so101(), cast("Planners", self), self, current, gate, self.clock, **parts)
        return GoalExecutor(self.arm.as_arm, context, self.in_progress)

    async def ask(self, request: Any, scene: Scene) -> Any:
        if isinstance(request, RecheckQuestion):
            self.rechecked.append(request)
            self.checked_in.append(scene.version)
            self.clock.advance(self.recheck_s)
            await self.checks_answer.wait()
            return self.late or RecheckAnswer(self.contact)
        if isinstance(request, ConcurrencyQuestion):
            self.meetings.append(request)
            await self.checks_answer.wait()
            return RecheckAnswer(self.meeting)
        if isinstance(request, NearestGoalQuestion):
            return NearestGoalAnswer(None)
        self.problems.append(request)
        self.scenes.append(scene.version)
        self.meanwhile()
        await self.planners_answer.wait()
        if self.failures:
            return self.failures.pop(0)
        ends = {**request.start_rad, **request.goal.positions_rad}
        moves = {name: (request.start_rad[name], ends[name]) for name in ARM}
        moved = any(start_rad != end_rad for start_rad, end_rad in moves.values())
        return Plan(smooth_move(moves, self.plan_s) if moved else STILL, "straight line", 0.01)

    async def begin(self, motion: Motion, limits: TimeLimits | None = None) -> None:
        self.goal = Goal(
            "1",
            GoalRequest("/goal", motion),
            lambda _goal, news: self.news.append(news),
            deadline=ExecutionDeadline(limits),
        )
        self.running = asyncio.create_task(self.executor.run(self.goal))
        await settle()

    async def answer(self) -> Any:
        assert self.running is not None
        return await asyncio.wait_for(self.running, TIMEOUT_S)

    async def arrive(self) -> Any:
        """Have the arm reach the end of its motion, and the goal its own."""
        self.arm.end()
        answer = await self.answer()
        assert answer.code is MoveItErrorCode.SUCCESS
        return answer

    def put_wall(self, version: int) -> None:
        self.scene, self.contact = Scene(version), WALL

    async def change(self, version: int) -> None:
        """Change the scene, and let it be checked."""
        self.scene = Scene(version)
        self.changed()
        await settle()

    def pass_time(self, seconds: float) -> None:
        """Let the same time pass on this machine's clock and on the arm's."""
        self.clock.advance(seconds)
        self.arm.pass_time(seconds)


@pytest.fixture
async def stage() -> Stage:
    return Stage()


def given(start_rad: float, end_rad: float) -> ExternalTrajectory:
    motion = smooth_move(dict.fromkeys(ARM, (start_rad, end_rad)), 2.0)
    return ExternalTrajectory(lambda *_start: motion, frozenset(ARM))


TOO_LONG = "the duration of the {} s, longer than goals.max_trajectory_duration_s = 0.9{}"


async def test_a_motion_that_takes_too_long_is_refused_and_not_planned_again(stage: Stage) -> None:
    planned, faster = replace(to(shoulder_pan=0.4), attempts=5), ": raise the velocity and acceleration scaling"
    for motion, code, words in (
        (planned, MoveItErrorCode.FAILURE, ("planned motion is 1", faster)),
        (given(0.0, 0.2), MoveItErrorCode.INVALID_MOTION_PLAN, ("trajectory is 2", "")),
    ):
        await stage.begin(motion, TimeLimits(trajectory_s=0.9))
        answer = await stage.answer()
        assert (answer.code, answer.message) == (code, TOO_LONG.format(*words))
    assert (len(stage.problems), stage.arm.played) == (1, [])


def unplug(stage: Stage) -> None:
    stage.arm.state = replace(stage.arm.state, mode=Mode.DISCONNECTED)


UNPLUGGED = PlanningFailure(MoveItErrorCode.COMMUNICATION_FAILURE, "the arm is not connected")
HELD_ELSEWHERE = PlanningFailure(MoveItErrorCode.CONTROL_FAILED, "but the arm holds it at")
STEERED = PlanningFailure(MoveItErrorCode.CONTROL_FAILED, "being steered")
REFUSED: list[tuple[Callable[[Stage], object], Motion, PlanningFailure]] = [
    (lambda stage: stage.put_wall(0), given(0.0, 0.2), WALL),
    (lambda stage: stage.put_wall(1), given(0.0, 0.2), WALL),
    (lambda stage: setattr(stage, "meanwhile", lambda: stage.put_wall(2)), to(shoulder_pan=0.4), WALL),
    (lambda _stage: None, given(0.3, 0.5), HELD_ELSEWHERE),
    (lambda stage: setattr(stage.arm, "steered", True), to(shoulder_pan=0.4), STEERED),
    (unplug, to(shoulder_pan=0.4), UNPLUGGED),
]


@pytest.mark.parametrize(("prepare", "motion", "failure"), REFUSED)
async def test_a_motion_that_scene_or_arm_forbid_as_they_are_then_does_not_begin(
    stage: Stage, prepare: Callable[[Stage], object], motion: Motion, failure: PlanningFailure
) -> None:
    prepare(stage)
    await stage.begin(motion)
    answer = await stage.answer()
    assert answer.code is failure.code
    assert failure.message in answer.message
    assert stage.arm.played == []


async def test_a_goal_waits_for_an_arm_that_is_being_started_and_moves_nothing_if_it_ends_before(stage: Stage) -> None:
    ended = Goal("1", GoalRequest("/goal", to(shoulder_pan=0.4)))
    ended.cancel("ended by a test")
    answers = [await stage.executor.run(ended)]
    stage.arm.started.clear()
    await stage.begin(given(0.0, 0.4))
    stage.goal.cancel("ended by a test")
    for answer in (*answers, await stage.answer()):
        assert (answer.code, answer.message) == (MoveItErrorCode.PREEMPTED, "ended by a test before the motion began")
    await stage.begin(to(shoulder_pan=0.4))
    assert (stage.problems, stage.arm.played) == ([], [])
    stage.arm.started.set()
    await settle()
    await stage.arrive()


@pytest.mark.parametrize(
    ("failures", "attempts", "tried"),
    [([NO_WAY], 3, 2), ([NO_WAY] * 9, 3, 3), ([NO_WAY] * 9, 2, 2), ([OUT_OF_REACH], 5, 1)],
)
async def test_planning_is_repeated_up_to_the_limit_unless_the_goal_is_out_of_reach(
    stage: Stage, failures: list[PlanningFailure], attempts: int, tried: int
) -> None:
    stage.failures = [*failures]
    await stage.begin(replace(to(shoulder_pan=0.4), attempts=attempts))
    stage.arm.end()
    answer = await stage.answer()
    assert len(stage.problems) == tried
    if tried <= len(failures):
        last = failures[-1]
        assert (answer.code, answer.message, answer.details) == (last.code, last.message, last.details)


async def test_a_motion_that_the_scene_stops_is_planned_again_from_the_present_position(stage: Stage) -> None:
    await stage.begin(replace(to(shoulder_pan=0.4), attempts=2))
    stage.put_wall(2)
    stage.arm.put(shoulder_pan=0.2)
    stage.changed()
    await settle()
    stage.contact = None
    await stage.arrive()
    assert [problem.start_rad["shoulder_pan"] for problem in stage.problems] == [0.0, 0.2]
    assert stage.scenes == [1, 2]


async def test_a_goal_is_planned_again_when_the_arm_was_moved_meanwhile(stage: Stage) -> None:
    stage.meanwhile = lambda: stage.arm.put(shoulder_pan=0.3)
    await stage.begin(to(shoulder_pan=0.4))
    await stage.arrive()
    assert [problem.start_rad["shoulder_pan"] for problem in stage.problems] == [0.0, 0.3]
    assert stage.arm.played[0].positions_rad[0, 0] == 0.3


async def test_a_stop_ends_planning_that_hangs(stage: Stage) -> None:
    stage.planners_answer.clear()
    await stage.begin(to(shoulder_pan=0.4))
    stage.goal.cancel("stopped by a test")
    answer = await stage.answer()
    assert (answer.code, answer.message) == (MoveItErrorCode.PREEMPTED, "stopped by a test while planning")


async def test_a_goal_where_the_arm_is_already_is_reached_without_a_motion(stage: Stage) -> None:
    await stage.begin(to(shoulder_pan=0.0))
    assert (await stage.answer()).message == "the arm was there already"
    assert stage.arm.played == []


async def test_an_external_trajectory_is_checked_and_played_from_where_the_arm_holds(stage: Stage) -> None:
    stage.arm.put(shoulder_pan=0.02)
    await stage.begin(given(0.0, 0.5))
    await stage.arrive()
    assert stage.arm.played[0].positions_rad[0, 0] == 0.02
    assert stage.rechecked[0].trajectory is stage.arm.played[0]
    assert set(stage.rechecked[0].others_rad) == {"gripper"}


# The motion that is played


REACHED, FAILED, LOST = MoveItErrorCode.SUCCESS, MoveItErrorCode.CONTROL_FAILED, MoveItErrorCode.COMMUNICATION_FAILURE
CODES = {Outcome.REACHED: REACHED, Outcome.BUS_LOST: LOST, Outcome.PROCESS_LOST: LOST}
CODES |= dict.fromkeys((Outcome.REFUSED, Outcome.TRACKING_LOST, Outcome.NOT_SETTLED, Outcome.FAULT), FAILED)


@pytest.mark.parametrize("outcome", CODES)
async def test_every_outcome_has_its_code_and_message_and_ends_the_monitoring(stage: Stage, outcome: Outcome) -> None:
    await stage.begin(to(shoulder_pan=0.4))
    stage.arm.end(outcome, "that is how it went")
    answer = await stage.answer()
    assert (answer.code, answer.message) == (CODES[outcome], "that is how it went")
    assert answer.details == {"outcome": outcome.value}
    stage.contact = WALL
    await stage.change(2)
    assert stage.rechecked == []


async def test_a_motion_whose_goal_ends_by_an_error_is_braked(stage: Stage) -> None:
    def broken(_goal: Goal, progress: Progress) -> None:
        if progress.state is GoalState.EXECUTING:
            raise ValueError("a bug")

    with pytest.raises(ValueError, match="a bug"):
        await stage.executor.run(Goal("1", GoalRequest("/goal", to(shoulder_pan=0.4)), broken))
    assert len(stage.arm.played) == len(stage.arm.stops) == 1
    assert stage.arm.stops != [None]


async def test_a_contact_on_the_way_stops_the_motion_with_its_code_and_details() -> None:
    stage = Stage(StubbornArm())
    await stage.begin(to(shoulder_pan=0.4))
    stage.contact = WALL
    await stage.change(2)
    assert len(stage.arm.stops) == 1
    stage.goal.cancel("too late")
    stage.arm.end(Outcome.STOPPED, "stopped half-way")
    answer = await stage.answer()
    assert (answer.code, answer.details) == (WALL.code, WALL.details)
    assert answer.message == "would touch the wall; stopped half-way"


@pytest.mark.parametrize(("direction", "from_s"), [(PlaybackDirection.FORWARD, 0.5), (PlaybackDirection.BACK, 0.0)])
async def test_the_scene_monitor_asks_about_the_rest_of_the_motion_and_on_the_way_back_about_all(
    stage: Stage, direction: PlaybackDirection, from_s: float
) -> None:
    await stage.begin(given(0.0, 0.4))
    stage.arm.fraction, stage.arm.state = 0.25, replace(stage.arm.state, pace=Pace(direction=direction))
    stage.contact = WALL
    await stage.change(2)
    assert [question.from_s for question in stage.rechecked] == [0.0, from_s]


async def test_changes_during_a_check_are_checked_together_and_none_after_the_motion(stage: Stage) -> None:
    await stage.begin(to(shoulder_pan=0.4))
    stage.checks_answer.clear()
    for version in range(2, 102):
        await stage.change(version)
    stage.checks_answer.set()
    await settle()
    assert stage.checked_in == [2, 101]
    stage.checks_answer.clear()
    stage.contact = WALL
    await stage.change(102)
    await stage.arrive()
    stage.checks_answer.set()
    await stage.change(103)
    assert stage.checked_in == [2, 101, 102]


async def test_a_scene_that_changed_during_the_check_before_the_motion_is_checked(stage: Stage) -> None:
    stage.meanwhile = lambda: setattr(stage, "scene", Scene(2))
    stage.checks_answer.clear()
    await stage.begin(to(shoulder_pan=0.4))
    await stage.change(3)
    stage.checks_answer.set()
    await settle()
    assert stage.checked_in == [2, 3]


@pytest.mark.parametrize(("code", "asked"), [(MoveItErrorCode.TIMED_OUT, 2), (MoveItErrorCode.FAILURE, 1)])
async def test_planners_that_fail_or_are_silent_for_longer_than_the_arm_may_be_stop_the_motion(
    stage: Stage, code: MoveItErrorCode, asked: int
) -> None:
    await stage.begin(to(shoulder_pan=0.4))
    stage.late, stage.recheck_s = PlanningFailure(code, "no answer"), 0.6 * stage.arm.state_max_age_s
    await stage.change(2)
    assert (await stage.answer()).code is MoveItErrorCode.COLLISION_CHECKING_UNAVAILABLE
    assert stage.checked_in == asked * [2]


class WornDeadline(ExecutionDeadline):
    exceeded = "the arm did not end the motion"


async def test_a_motion_that_gets_nowhere_is_braked_and_names_the_joint_that_lags(stage: Stage) -> None:
    goal = Goal("1", GoalRequest("/goal", to(shoulder_pan=0.4)), deadline=WornDeadline())
    answer = await stage.executor.run(goal)
    assert answer.code is MoveItErrorCode.TIMED_OUT
    assert answer.message.startswith("the arm did not end the motion; joint ")
    assert "is 0.000 rad behind; stopped half-way" in answer.message
    stage.arm.state = replace(stage.arm.state, position_rad=None)
    answer = await stage.executor.run(Goal("2", goal.request, deadline=WornDeadline()))
    assert "; its joint positions are unknown; " in answer.message


LOOKS_S = 10.0 * execution.PROGRESS_PERIOD_S
LIMITS = TimeLimits(scaling=3.0)


@pytest.mark.stepped_time
async def test_the_end_of_an_outgoing_motion_is_awaited_by_the_arms_clock() -> None:
    stage = Stage(StubbornArm())
    await stage.begin(to(shoulder_pan=0.4))
    stage.goal.cancel("preempted by a test", replaced=True)
    await stage.answer()
    resting = asyncio.create_task(stage.executor._stop_outgoing())
    await asyncio.sleep(LOOKS_S)
    stage.arm.pass_time(0.9 * execution.BRAKING_TIMEOUT_S)
    await asyncio.sleep(LOOKS_S)
    assert not resting.done()
    stage.arm.pass_time(0.2 * execution.BRAKING_TIMEOUT_S)
    await asyncio.wait_for(resting, TIMEOUT_S)


@pytest.mark.stepped_time
async def test_a_silent_arm_is_not_awaited() -> None:
    stage = Stage(StubbornArm())
    await stage.begin(to(shoulder_pan=0.4), LIMITS)
    stage.pass_time(1.1 * LIMITS.allowed_s(1.0))
    await asyncio.sleep(LOOKS_S)
    stage.arm.state_age_s = 5.1
    assert (await stage.answer()).code is MoveItErrorCode.COMMUNICATION_FAILURE


@pytest.mark.stepped_time
async def test_the_pauses_of_all_motions_of_a_goal_count_together(stage: Stage) -> None:
    there, back = to(shoulder_pan=0.4), to(shoulder_pan=0.0)
    await stage.begin(replace(there, steps=there.steps + back.steps), LIMITS)
    stage.arm.state = replace(stage.arm.state, pace=Pace(1.0, PlaybackDirection.PAUSED))
    for _ in range(2):
        stage.pass_time(0.6 * LIMITS.paused_s)
        await asyncio.sleep(LOOKS_S)
        stage.arm.end()
        await settle()
    answer = await stage.answer()
    assert answer.code is MoveItErrorCode.TIMED_OUT
    assert answer.message.startswith("the motion was paused or going back for 720 s (limit 600 s)")


async def test_a_braking_motion_is_not_replaced(stage: Stage) -> None:
    await stage.begin(to(shoulder_pan=0.4))
    stage.goal.cancel("a test")
    stage.goal.cancel("too late", replaced=True)
    assert (await stage.answer()).message == "a test; stopped half-way"


# The motion that another one replaces


async def under_way(stage: Stage) -> None:
    """Let a motion be seen half done, give way, and its answer come."""
    await stage.begin(to(shoulder_pan=0.4))
    stage.pass_time(2.0 * STATE_AGE_S)
    stage.arm.show(0.5)
    stage.goal.cancel("preempted by a test", replaced=True)
    assert (await stage.answer()).message == "preempted by a test"


async def test_a_motion_is_left_to_no_other_before_the_arm_shows_that_it_has_begun(stage: Stage) -> None:
    await stage.begin(to(shoulder_pan=0.4))
    stage.arm.state = replace(stage.arm.state, mode=Mode.HOLDING)
    stage.goal.cancel("preempted by a test", replaced=True)
    await settle()
    assert stage.running is not None
    assert not stage.running.done()
    stage.arm.state = replace(stage.arm.state, mode=Mode.MOVING)
    assert (await stage.answer()).message == "preempted by a test"


async def test_a_motion_that_the_arm_does_not_show_is_left_by_the_time_since_it_was_sent(stage: Stage) -> None:
    await stage.begin(to(shoulder_pan=0.4))
    for position_rad in (-0.2, 0.1):
        stage.arm.state = replace(stage.arm.state, mode=Mode.HOLDING)
        stage.pass_time(0.2)
        stage.goal.cancel("preempted by a test", replaced=True)
        await stage.answer()
        await stage.begin(to(shoulder_pan=position_rad))
    # Each lead begins 0.1 s before; the second motion is as long under way as its own lead and the pause together.
    assert stage.arm.continued == pytest.approx([0.2 - STATE_AGE_S, STATE_AGE_S + 0.2 - STATE_AGE_S])


@pytest.mark.parametrize("task_ends", [False, True])
async def test_a_cancelled_goal_ends_its_work_and_its_task_only_where_that_is_cancelled_too(*, task_ends: bool) -> None:
    goal = Goal("1", GoalRequest("/goal"))

    async def wait() -> tuple[object, int]:
        found = await goal.unless_cancelled(asyncio.Event().wait())
        await asyncio.sleep(0.0)
        return found, cast("asyncio.Task[Any]", asyncio.current_task()).cancelling()

    waiting = asyncio.create_task(wait())
    await settle()
    goal.cancel("a test")
    if task_ends:
        waiting.cancel()
    await asyncio.wait([waiting])
    assert waiting.cancelled() if task_ends else waiting.result() == (None, 0)


@pytest.mark.stepped_time
async def test_an_outgoing_motion_is_braked_when_none_replaces_it(stage: Stage) -> None:
    await under_way(stage)
    await until(lambda: stage.arm.stops)


@pytest.mark.parametrize("changed", [False, True])
async def test_a_goal_replaces_the_motion_of_the_preempted_goal_without_a_stop_and_is_checked_after_a_change(
    stage: Stage, *, changed: bool
) -> None:
    stage.plan_s = 2.0
    await under_way(stage)
    stage.scene = Scene(1 + changed)
    await stage.begin(to(shoulder_pan=-0.2))
    answer = await stage.arrive()
    assert stage.checked_in == [2] * changed
    assert stage.arm.stops == []
    former, whole = stage.arm.played
    from_s = stage.arm.continued[0]
    assert from_s == pytest.approx(0.5 * stage.plan_s - STATE_AGE_S)
    np.testing.assert_allclose(whole.sample(0.1)[0], former.sample(from_s + 0.1)[0], atol=1e-9)
    assert stage.problems[-1].start_velocity_rad_s["shoulder_pan"] > 0.0
    assert answer.performed.planned == (whole,)


async def test_a_goal_that_is_replaced_before_it_begins_leaves_the_motion_on_its_way_to_the_next(stage: Stage) -> None:
    await under_way(stage)
    goal = Goal("2", GoalRequest("/goal", ExternalTrajectory(Given(), frozenset(ARM))))
    goal.cancel("preempted by goal 3", replaced=True)
    answer = await stage.executor.run(goal)
    assert (answer.code, answer.message) == (MoveItErrorCode.PREEMPTED, "preempted by goal 3 before the motion began")
    assert stage.arm.stops == []


class Given:
    """A trajectory that continues where it is asked to; it knows when each attempt was to begin, and prepares it."""

    def __init__(self, prepare: Callable[[int], object] = lambda _attempt: None) -> None:
        self._prepare = prepare
        self.begins_s: list[float] = []

    def __call__(self, positions_rad: Positions, at_s: float, point: SplicePoint | None) -> Trajectory:
        self._prepare(len(self.begins_s))
        self.begins_s.append(at_s)
        held_rad = positions_rad if point is None else point.positions_rad
        return smooth_move({name: (held_rad[name], held_rad[name] + 0.1) for name in ARM}, 1.0)


@pytest.mark.parametrize("motion", [to(shoulder_pan=-0.2), ExternalTrajectory(Given(), frozenset(ARM))])
async def test_a_goal_whose_motion_takes_too_long_replaces_no_motion_and_the_arm_brakes(
    stage: Stage, motion: Motion
) -> None:
    await under_way(stage)
    await stage.begin(motion, TimeLimits(trajectory_s=0.9))
    assert "longer than goals.max_trajectory_duration_s = 0.9" in (await stage.answer()).message
    assert len(stage.arm.played) == 1
    assert len(stage.arm.stops) >= 1


# The third comes shortly before the arm would brake.
@pytest.mark.parametrize(
    ("waited_s", "spliced", "ahead_s"),
    [(0.0, True, 0.1305), (0.0, False, 0.0), (0.4, True, OUTGOING_S - SENDING_S - 0.4)],
)
async def test_a_given_trajectory_replaces_the_motion_unless_it_begins_at_rest(
    stage: Stage, waited_s: float, spliced: bool, ahead_s: float
) -> None:
    await under_way(stage)
    stage.pass_time(waited_s)
    trajectory, asked_s = Given(), stage.clock()
    await stage.begin(ExternalTrajectory(trajectory, frozenset(ARM), spliced=spliced))
    await until(lambda: len(stage.arm.played) == 2)
    await stage.arrive()
    assert (stage.arm.stops == []) is spliced
    assert len(stage.arm.continued) == int(spliced)
    # Nothing is known yet of how long a check takes.
    assert trajectory.begins_s == pytest.approx([asked_s + ahead_s])
    assert len(stage.rechecked) == 1


# Also after a busy moment, and where the last check is a little late. The arm's next tick is up to 10 ms later.
@pytest.mark.parametrize(
    ("checks_s", "least_s", "most_s"),
    [((), 0.0, 0.005), ((0.008, 0.1, 0.008), -1.0, 0.01), ((0.008, 0.016), -1.0, 0.01)],
)
async def test_a_given_trajectory_changes_the_goals_within_15_ms_of_its_answer(
    stage: Stage, checks_s: tuple[float, ...], least_s: float, most_s: float
) -> None:
    await under_way(stage)
    for stage.recheck_s in (0.008, 0.008, *checks_s):
        trajectory, stage.news = Given(), []
        await stage.begin(ExternalTrajectory(trajectory, frozenset(ARM)))
        await until(lambda: any(each.state is GoalState.EXECUTING for each in stage.news))
        stage.arm.show(0.2)
        stage.goal.cancel("preempted by a test", replaced=True)
        await stage.answer()
    assert least_s <= trajectory.begins_s[-1] - stage.clock() <= most_s
    assert len(trajectory.begins_s) == 1
    assert stage.arm.stops == []
    assert len(stage.arm.continued) == 2 + len(checks_s)


async def test_a_given_trajectory_whose_check_was_late_takes_over_just_behind_the_tick_that_it_missed(
    stage: Stage,
) -> None:
    await stage.begin(to(shoulder_pan=0.4))
    for first_check_s in (0.004, 0.004, 0.004, 0.004, 0.004, 0.008):
        checks_s = first_check_s, 0.004
        trajectory = Given(lambda attempt, checks_s=checks_s: setattr(stage, "recheck_s", checks_s[attempt]))
        tick_s, stage.news = stage.clock() - 0.003, []
        stage.arm.show(0.2)
        stage.arm.state = replace(stage.arm.state, tick_s=tick_s)
        stage.goal.cancel("preempted by a test", replaced=True)
        await stage.answer()
        await stage.begin(ExternalTrajectory(trajectory, frozenset(ARM)))
        await until(lambda: any(each.state is GoalState.EXECUTING for each in stage.news))
    assert [each - tick_s for each in trajectory.begins_s] == pytest.approx([TICK_LATE_S, PERIOD_S + TICK_LATE_S])
    assert stage.arm.stops == []


async def test_listeners_hear_of_a_given_trajectory_when_the_arm_has_it(stage: Stage) -> None:
    await under_way(stage)
    heard: list[int] = []
    request = GoalRequest("/goal", ExternalTrajectory(Given(), frozenset(ARM)))
    goal = Goal("2", request, lambda *_: heard.append(len(stage.arm.played)))
    running = asyncio.create_task(stage.executor.run(goal))
    await until(lambda: heard)
    assert heard[0] == 2
    stage.arm.end()
    await running


@pytest.mark.parametrize("refusals", [1, 3, 4])
async def test_a_given_trajectory_that_came_too_late_is_sent_again_three_times(stage: Stage, refusals: int) -> None:
    stage.recheck_s = 0.008
    await under_way(stage)
    trajectory = Given(lambda attempt: setattr(stage.arm, "refusing", attempt < refusals))
    await stage.begin(ExternalTrajectory(trajectory, frozenset(ARM)))
    await until(lambda: len(stage.arm.played) == 2 + refusals)
    await stage.arrive()
    assert (stage.arm.stops == []) is (refusals <= 3)
    assert len(trajectory.begins_s) == refusals + 1


# Planning takes too long, there is no plan, the arm has left the place, it goes back, or another motion is in progress;
# or the goal is a sequence, in a scene of its own, or one that people confirm.
OBSTACLES: list[tuple[Callable[[Stage], object], dict[str, Any]]] = [
    (lambda stage: stage.planners_answer.clear(), {}),
    (lambda stage: stage.failures.append(NO_WAY), {}),
    (lambda stage: setattr(stage.arm, "refusing", True), {}),
    (lambda stage: setattr(stage.executor._outgoing, "path_time", PathTime(0.0, 0.0, 0.0)), {}),
    (lambda stage: beside(stage), {}),
    (lambda _stage: None, {"steps": 2 * to(shoulder_pan=-0.2).steps}),
    (lambda _stage: None, {"scene": lambda _: Scene(7)}),
    (
        lambda stage: setattr(stage.executor._context.confirmation, "wait", AsyncMock(return_value=None)),
        {"confirm": True},
    ),
]


@pytest.mark.parametrize(("obstacle", "changes"), OBSTACLES)
async def test_the_arm_brakes_for_a_motion_it_cannot_blend(
    stage: Stage, obstacle: Callable[[Stage], object], changes: dict[str, Any]
) -> None:
    await under_way(stage)
    obstacle(stage)
    await stage.begin(replace(to(shoulder_pan=-0.2), **changes))
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

    def report(goal: Goal, progress: Progress) -> None:
        if progress.message == "planning in motion":
            goal.cancel("cancelled by a test")

    goal = Goal("2", GoalRequest("/goal", to(shoulder_pan=-0.2)), report)
    answer = await asyncio.wait_for(stage.executor.run(goal), TIMEOUT_S)
    # A question that is never awaited is an error of the test run.
    gc.collect()
    assert answer.code is MoveItErrorCode.PREEMPTED
    assert len(stage.problems) == asked


FINGER = smooth_move({"gripper": (0.0, 0.7)}, 1.0)
MIGHT_TOUCH = PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, "the finger may touch the arm")


def beside(stage: Stage) -> asyncio.Future[MotionEnded]:
    """Have the gripper move for another goal; returns the end of its motion."""
    ended: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
    stage.in_progress.add(FINGER, ended)
    return ended


async def test_a_motion_waits_for_one_that_it_may_touch_and_is_checked_anew_where_that_stopped(stage: Stage) -> None:
    ended, stage.meeting = beside(stage), MIGHT_TOUCH
    await stage.begin(to(shoulder_pan=0.4))
    assert stage.arm.played == []
    assert stage.news[-1] == Progress(GoalState.PLANNED, "waits for the motion of gripper, which it might touch")
    stage.arm.put(gripper=0.3)
    ended.set_result(MotionEnded(1, Outcome.STOPPED, "stopped"))
    await settle()
    assert [question.others_rad for question in stage.rechecked] == [{"gripper": 0.3}]
    assert len(stage.arm.played) == 1


async def test_a_goal_that_waits_for_a_motion_can_be_cancelled(stage: Stage) -> None:
    beside(stage)
    stage.meeting = MIGHT_TOUCH
    await stage.begin(to(shoulder_pan=0.4))
    stage.goal.cancel("enough")
    assert (await stage.answer()).code is MoveItErrorCode.PREEMPTED
    assert stage.arm.played == []


@pytest.mark.parametrize("found_by", ["contact", "meeting"])
async def test_the_monitor_asks_about_motions_beside_as_well(stage: Stage, found_by: str) -> None:
    await stage.begin(to(shoulder_pan=0.4))
    beside(stage)
    setattr(stage, found_by, MIGHT_TOUCH)
    await stage.change(2)
    assert (await stage.answer()).message.startswith("the finger may touch the arm")
    assert stage.rechecked[0].others_rad == {"gripper": 0.7}


async def test_a_motion_of_a_preempted_goal_of_another_group_is_braked_first(stage: Stage) -> None:
    motion = smooth_move({"shoulder_pan": (0.0, 0.5)}, 1.0)
    outgoing = stage.arm.execute(motion)
    stage.in_progress.add(motion, outgoing)
    await stage.begin(to(shoulder_pan=0.4))
    assert stage.arm.stops == [outgoing]
    assert len(stage.arm.played) == 2


async def test_a_goal_is_planned_after_those_that_came_before_for_where_they_end(stage: Stage) -> None:
    """Its group may have no place yet where the motion of the other, still being planned, makes room."""
    stage.planners_answer.clear()
    await stage.begin(to(shoulder_pan=0.4))
    second = asyncio.create_task(stage.executing().run(Goal("2", GoalRequest("/goal", to("gripper", gripper=0.5)))))
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
    await stage.begin(to("gripper", gripper=0.5))
    assert stage.problems[-1].start_rad["shoulder_pan"] == 0.0


async def test_a_motion_that_begins_during_the_last_check_is_checked_as_well(stage: Stage) -> None:
    first = beside(stage)
    stage.checks_answer.clear()
    await stage.begin(to(shoulder_pan=0.4))
    first.set_result(MotionEnded(1, Outcome.REACHED, "there"))
    beside(stage)
    stage.checks_answer.set()
    await settle()
    assert len(stage.meetings) == 2
    assert len(stage.arm.played) == 1
