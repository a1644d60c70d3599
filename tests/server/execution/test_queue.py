from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable
from typing import Any

import pytest

from planners.problem import MoveItErrorCode, PlanningFailure
from server.execution.goal import Answer, Goal, GoalPolicy, GoalRequest, GoalState, Progress
from server.execution.queue import GoalQueue, RunningGoal
from server.execution.time_limits import TimeLimits
from tests.helpers.fake_arm import settle
from tests.helpers.goal_runner import GoalRunner


class Move(str):
    """A motion of the only joint, with a name."""

    __slots__ = ()
    joints = frozenset({"joint"})


class MoveOfArms(str):
    """A motion of the joints that its words name."""

    __slots__ = ()

    @property
    def joints(self) -> frozenset[str]:
        return frozenset(self.split())


class BrokenError(ValueError):
    """A motion for which its executor raises it."""

    joints = Move.joints


class ScriptedRunner(GoalRunner):
    async def run(self, goal: Goal) -> Answer:
        goal.report(Progress(GoalState.PLANNING, "planning"))
        if isinstance(goal.request.motion, Exception):
            raise goal.request.motion
        return await super().run(goal)


class Desk:
    """A queue, its executor, and all that it told."""

    move: type[str] = Move

    def __init__(self, policy: GoalPolicy = GoalPolicy.QUEUE, runner: ScriptedRunner | None = None) -> None:
        self.runner = runner or ScriptedRunner()
        self.states: list[tuple[str, GoalState]] = []
        self.answers: list[tuple[str, Answer]] = []
        self.queue: GoalQueue = GoalQueue(self.runner, policy, 3, self._progress, self._answer)
        self.queue.start()

    async def submit(self, *requests: object) -> None:
        """Submit goals; each is begun, or waits, before the next one comes."""
        for request in requests:
            self.queue.submit(GoalRequest("/goal", request if isinstance(request, Exception) else self.move(request)))
            await settle()

    async def finish(self) -> None:
        """Reach the active goal, and let the next one begin."""
        self.runner.finish()
        await settle()

    def _progress(self, goal: Goal, progress: Progress) -> None:
        self.states.append((goal.goal_id, progress.state))

    def _answer(self, goal: Goal, answer: Answer) -> None:
        self.answers.append((goal.goal_id, answer))

    def codes(self) -> list[tuple[str, MoveItErrorCode]]:
        return [(goal_id, answer.code) for goal_id, answer in self.answers]


@pytest.fixture
async def desk() -> AsyncIterator[Desk]:
    made = Desk()
    yield made
    await made.queue.close(0.1)


async def desk_of(policy: GoalPolicy, *requests: str) -> Desk:
    made = Desk(policy)
    await made.submit(*requests)
    return made


async def test_goals_run_one_at_a_time_in_order_of_arrival(desk: Desk) -> None:
    for name in "abc":
        desk.queue.submit(GoalRequest("/goal", desk.move(name)))
    for count in (1, 2, 3):
        await settle()
        assert len(desk.runner.asked) == count
        await desk.finish()
    assert desk.runner.asked == ["a", "b", "c"]
    assert desk.codes() == [(str(number), MoveItErrorCode.SUCCESS) for number in (1, 2, 3)]


async def test_the_active_goal_is_told_with_its_client_its_time_left_and_those_behind_it(desk: Desk) -> None:
    assert desk.queue.running() is None
    desk.queue.submit(GoalRequest("/goals", desk.move("first"), client="unity"))
    await settle()
    assert desk.queue.running() == RunningGoal("goal 1 of unity from /goals", None, 0)
    desk.queue.submit(GoalRequest("/goals", desk.move("second")))
    desk.runner.report(Progress(GoalState.EXECUTING, "", 0.25, 3.0))
    assert desk.queue.running() == RunningGoal("goal 1 of unity from /goals", 3.0, 1)
    await desk.finish()
    assert desk.queue.running() == RunningGoal("goal 2 from /goals", None, 0)


async def test_a_goal_over_the_capacity_is_rejected_with_the_limit(desk: Desk) -> None:
    await desk.submit(*"xxxxx")
    assert desk.codes() == [("5", MoveItErrorCode.FAILURE)]
    assert desk.queue.waiting_count == 3
    assert "3 goals are waiting" in desk.answers[0][1].message


async def test_a_rejected_goal_is_answered_at_once_while_another_runs(desk: Desk) -> None:
    await desk.submit("a")
    goal = desk.queue.reject(GoalRequest("/goal"), PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "no"))
    assert desk.codes() == [(goal.goal_id, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS)]
    assert desk.runner.asked == ["a"]


async def test_stop_answers_the_active_goal_and_all_that_wait(desk: Desk) -> None:
    await desk.submit(*"xxx")
    desk.queue.stop("stopped by a test")
    await settle()
    assert sorted(desk.codes()) == [(str(number), MoveItErrorCode.PREEMPTED) for number in (1, 2, 3)]
    assert all("stopped by a test" in answer.message for _, answer in desk.answers)
    assert desk.runner.asked == ["x"]


async def test_the_queue_works_on_after_a_stop(desk: Desk) -> None:
    await desk.submit("a")
    desk.queue.stop("stopped")
    await desk.submit("b")
    await desk.finish()
    assert desk.codes() == [("1", MoveItErrorCode.PREEMPTED), ("2", MoveItErrorCode.SUCCESS)]


async def test_policy_reject_rejects_goals_while_one_is_active() -> None:
    desk = await desk_of(GoalPolicy.REJECT, "a", "b")
    assert desk.codes() == [("2", MoveItErrorCode.FAILURE)]
    assert "goal 1" in desk.answers[0][1].message
    await desk.queue.close(0.1)


async def test_policy_preempt_ends_the_active_goal_and_runs_the_new_one() -> None:
    desk = await desk_of(GoalPolicy.PREEMPT, "a", "b")
    assert desk.codes() == [("1", MoveItErrorCode.PREEMPTED)]
    assert "preempted by goal 2 from /goal" in desk.answers[0][1].message
    assert desk.runner.asked == ["a", "b"]
    await desk.queue.close(0.1)


async def test_a_bug_in_the_runner_costs_its_goal_only(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    desk.queue.submit(GoalRequest("/goal", BrokenError("broken")))
    await desk.submit("b")
    await desk.finish()
    assert desk.codes() == [("1", MoveItErrorCode.FAILURE), ("2", MoveItErrorCode.SUCCESS)]
    assert "broken" in desk.answers[0][1].message
    assert "goal 1" in caplog.text


async def test_closing_answers_every_goal() -> None:
    desk = await desk_of(GoalPolicy.QUEUE, "a", "b")
    await desk.queue.close(1.0)
    assert sorted(desk.codes()) == [("1", MoveItErrorCode.PREEMPTED), ("2", MoveItErrorCode.PREEMPTED)]


class DeafRunner(ScriptedRunner):
    """Ends nothing, whatever it is told."""

    def cancel(self, reason: str) -> None:
        self.stopped.append(reason)


async def test_closing_answers_a_goal_that_does_not_end() -> None:
    desk = Desk(runner=DeafRunner())
    await desk.submit("a")
    await desk.queue.close(0.01)
    assert desk.codes() == [("1", MoveItErrorCode.PREEMPTED)]
    assert "did not come to rest in time" in desk.answers[0][1].message


async def test_closing_that_is_cut_short_answers_the_active_goal() -> None:
    desk = Desk(runner=DeafRunner())
    await desk.submit("a")
    closing = asyncio.create_task(desk.queue.close(60.0))
    await settle()
    closing.cancel()
    await asyncio.wait([closing])
    await settle()
    assert desk.codes() == [("1", MoveItErrorCode.PREEMPTED)]


async def test_a_waiting_goal_reports_how_many_are_ahead(desk: Desk) -> None:
    await desk.submit("a")
    desk.queue.submit(GoalRequest("/goal", desk.move("b")))
    assert desk.states == [("1", GoalState.QUEUED), ("1", GoalState.PLANNING), ("2", GoalState.QUEUED)]


@pytest.mark.parametrize("number", ["1", "2"], ids=["in hand", "waiting"])
async def test_a_cancelled_goal_is_answered_and_the_other_is_not(desk: Desk, number: str) -> None:
    await desk.submit(*"ab")
    desk.queue.cancel(number, "cancelled")
    await settle()
    assert desk.codes() == [(number, MoveItErrorCode.PREEMPTED)]


async def test_a_bug_in_a_listener_costs_no_other_goal(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    def broken(_news: object) -> None:
        raise ValueError("broken listener")

    desk.queue.submit(GoalRequest("/goal", desk.move("a"), on_progress=broken, on_answer=broken))
    await desk.submit("b")
    await desk.finish()
    assert desk.runner.asked == ["a", "b"]
    assert desk.codes() == [("1", MoveItErrorCode.SUCCESS)]
    assert "broken listener" in caplog.text


class TwoArms:
    """Runners of goals that name their joints in a word: ``left``, ``right`` or ``left right``."""

    def __init__(self) -> None:
        self.time_limits = TimeLimits()
        self.runners: dict[frozenset[str], ScriptedRunner] = {}
        self.stopped: list[Any] = []

    def last_stop(self, _joints: frozenset[str]) -> int:
        return 0

    def executor(self, joints: frozenset[str]) -> ScriptedRunner:
        return self.runners.setdefault(joints, ScriptedRunner())

    def stop(self, joints: Iterable[str] | None = None) -> None:
        self.stopped.append(joints)

    def of(self, name: str) -> ScriptedRunner:
        return self.runners[frozenset(name.split())]

    @property
    def started(self) -> set[str]:
        """The goals that were begun."""
        return {str(motion) for runner in self.runners.values() for motion in runner.asked}


class ArmsDesk(Desk):
    """A queue of two arms, and all that it told."""

    move = MoveOfArms

    def __init__(self, policy: GoalPolicy = GoalPolicy.QUEUE) -> None:
        super().__init__()
        self.arms = TwoArms()
        self.queue = GoalQueue(self.arms, policy, 3, self._progress, self._answer)
        self.queue.start()


async def test_a_goal_of_both_arms_waits_for_each() -> None:
    desk = ArmsDesk()
    await desk.submit("left", "right", "left right")
    desk.arms.of("left").finish()
    await settle()
    assert desk.arms.started == {"left", "right"}
    desk.arms.of("right").finish()
    await settle()
    assert desk.arms.started == {"left", "right", "left right"}


async def test_no_goal_overtakes_one_that_waits_for_the_same_joints() -> None:
    desk = ArmsDesk()
    await desk.submit("left", "left right", "right")
    assert desk.arms.started == {"left"}
    desk.arms.of("left").finish()
    await settle()
    assert desk.arms.started == {"left", "left right"}


async def test_a_goal_preempts_only_goals_of_its_joints() -> None:
    desk = ArmsDesk(GoalPolicy.PREEMPT)
    await desk.submit("left", "right", "left")
    assert desk.codes() == [("1", MoveItErrorCode.PREEMPTED)]
    assert desk.queue.active_count == 2


async def test_a_goal_is_rejected_only_for_a_goal_of_its_joints() -> None:
    desk = ArmsDesk(GoalPolicy.REJECT)
    await desk.submit("left", "right", "right")
    assert desk.codes() == [("3", MoveItErrorCode.FAILURE)]
    assert "goal 2" in desk.answers[0][1].message


async def test_a_stop_ends_the_goals_of_all_joints() -> None:
    desk = ArmsDesk()
    await desk.submit("left", "right", "left right")
    desk.queue.stop("stopped by a test")
    await settle()
    assert sorted(desk.codes()) == [(str(number), MoveItErrorCode.PREEMPTED) for number in (1, 2, 3)]
    assert desk.arms.stopped == [None]


async def test_the_goals_of_some_joints_are_cancelled_alone() -> None:
    desk = ArmsDesk()
    await desk.submit("left", "right", "left")
    desk.queue.cancel_all("enough", ["left"])
    await settle()
    assert sorted(desk.codes()) == [("1", MoveItErrorCode.PREEMPTED), ("3", MoveItErrorCode.PREEMPTED)]
    assert desk.queue.active_count == 1


async def test_a_goal_preempts_waiting_goals_of_its_joints_alone() -> None:
    desk = ArmsDesk()
    await desk.submit("left", "right", "left", "right")
    desk.queue.submit(GoalRequest("/goal", desk.move("left"), policy=GoalPolicy.PREEMPT))
    await settle()
    assert sorted(desk.codes()) == [("1", MoveItErrorCode.PREEMPTED), ("3", MoveItErrorCode.PREEMPTED)]
    assert desk.queue.waiting_count == 1


def move(runner: ScriptedRunner, left_s: float = 3.0) -> None:
    """Have the active goal of a runner report its motion."""
    runner.report(Progress(GoalState.EXECUTING, "moving", 0.5, left_s))


async def test_a_goal_that_comes_during_a_motion_is_planned_ahead_at_once(desk: Desk) -> None:
    await desk.submit("a")
    move(desk.runner)
    desk.queue.submit(GoalRequest("/goal", desk.move("b")))
    assert desk.runner.ahead == [("b", 3.0)]


async def test_a_bug_of_planning_ahead_harms_no_goal(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(desk.runner, "ahead", None)
    for name in "ab":
        desk.queue.submit(GoalRequest("/goal", desk.move(name)))
        await settle()
        move(desk.runner)
    for _ in "ab":
        desk.runner.finish()
        await settle()
    assert desk.codes() == [("1", MoveItErrorCode.SUCCESS), ("2", MoveItErrorCode.SUCCESS)]


@pytest.mark.parametrize("waiting", [("left right",), ("left right", "left"), ("right",)])
async def test_a_goal_that_waits_for_more_than_this_motion_is_not_planned_ahead(waiting: tuple[str, ...]) -> None:
    desk = ArmsDesk()
    await desk.submit("left", "right", *waiting)
    move(desk.arms.of("left"))
    assert all(runner.ahead == [] for runner in desk.arms.runners.values())


async def test_a_goal_that_is_cancelled_before_its_turn_is_forgotten(desk: Desk) -> None:
    await desk.submit(*"abc")
    desk.queue.cancel("2", "enough")
    assert desk.runner.forgotten == ["b"]
