import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from typing import Any

import pytest

from planners.problem import MoveItErrorCode, PlanningFailure
from server.execution.goal import Answer, Goal, GoalPolicy, GoalRequest, GoalState, Progress, TimeLimits
from server.execution.queue import GoalListener, GoalQueue, RunningGoal
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


class Desk(GoalListener):
    """A queue, its executor, and all that it told."""

    move: type[str] = Move

    def __init__(self, policy: GoalPolicy = GoalPolicy.QUEUE, runner: ScriptedRunner | None = None) -> None:
        self.runner = runner or ScriptedRunner()
        self.states: list[tuple[str, GoalState]] = []
        self.answers: list[tuple[str, Answer]] = []
        self.open(GoalQueue(self.runner, policy, 3))

    def open(self, queue: GoalQueue) -> None:
        self.queue = queue
        queue.listeners.append(self)
        queue.start()

    async def submit(self, *requests: object) -> None:
        """Submit goals; each is begun, or waits, before the next one comes."""
        for request in requests:
            self.queue.submit(GoalRequest("/goal", request if isinstance(request, Exception) else self.move(request)))
            await settle()

    async def finish(self) -> None:
        """Reach the active goal, and let the next one begin."""
        self.runner.finish()
        await settle()

    def on_progress(self, goal: Goal, progress: Progress) -> None:
        self.states.append((goal.goal_id, progress.state))

    def on_answer(self, goal: Goal, answer: Answer) -> None:
        self.answers.append((goal.goal_id, answer))

    def codes(self) -> list[tuple[str, MoveItErrorCode]]:
        return [(goal_id, answer.code) for goal_id, answer in self.answers]


@pytest.fixture
async def desk() -> AsyncIterator[Desk]:
    made = Desk()
    yield made
    await made.queue.close(0.1)


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


async def test_a_goal_is_told_how_many_are_ahead_of_it(desk: Desk) -> None:
    assert desk.queue.busy() == ""
    goals = [desk.queue.submit(GoalRequest("/goal", desk.move(name))) for name in "abc"]
    waiting = [goal.progress.message for goal in goals if goal.progress is not None]
    assert waiting == ["next", "1 goals ahead", "2 goals ahead"]
    await settle()
    assert desk.queue.busy() == "goal 1 from /goal is worked on"


async def test_a_rejected_goal_is_answered_at_once_while_another_runs(desk: Desk) -> None:
    await desk.submit("a")
    goal = desk.queue.reject(GoalRequest("/goal"), PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "no"))
    assert desk.codes() == [(goal.goal_id, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS)]
    assert desk.runner.asked == ["a"]


async def test_a_bug_in_the_runner_costs_its_goal_only(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    desk.queue.submit(GoalRequest("/goal", BrokenError("broken")))
    await desk.submit("b")
    await desk.finish()
    assert desk.codes() == [("1", MoveItErrorCode.FAILURE), ("2", MoveItErrorCode.SUCCESS)]
    assert "broken" in desk.answers[0][1].message
    assert "goal 1" in caplog.text


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


@pytest.mark.stepped_time
async def test_closing_waits_no_longer_than_until_the_active_goal_has_ended() -> None:
    desk = Desk(runner=DeafRunner())
    await desk.submit("a")
    closing = asyncio.create_task(desk.queue.close(60.0))
    await asyncio.sleep(1.0)
    desk.runner.finish()
    await closing
    assert asyncio.get_running_loop().time() < 2.0


async def test_closing_that_is_cut_short_answers_the_active_goal() -> None:
    desk = Desk(runner=DeafRunner())
    await desk.submit("a")
    closing = asyncio.create_task(desk.queue.close(60.0))
    await settle()
    closing.cancel()
    await asyncio.wait([closing])
    await settle()
    assert desk.codes() == [("1", MoveItErrorCode.PREEMPTED)]


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


class ArmsDesk(Desk):
    """A queue of two arms, and all that it told."""

    move = MoveOfArms

    def __init__(self, policy: GoalPolicy = GoalPolicy.QUEUE) -> None:
        super().__init__()
        self.arms = TwoArms()
        self.open(GoalQueue(self.arms, policy, 3))


def submit(*requests: str, policy: GoalPolicy | None = None) -> Callable[[ArmsDesk], Awaitable[None]]:
    async def act(desk: ArmsDesk) -> None:
        for request in requests:
            desk.queue.submit(GoalRequest("/goal", desk.move(request), policy=policy))
            await settle()

    return act


def finish(*names: str) -> Callable[[ArmsDesk], Awaitable[None]]:
    async def act(desk: ArmsDesk) -> None:
        for name in names:
            desk.arms.of(name).finish()
            await settle()

    return act


def end(act: Callable[[GoalQueue], object]) -> Callable[[ArmsDesk], Awaitable[None]]:
    async def ended(desk: ArmsDesk) -> None:
        act(desk.queue)
        await settle()

    return ended


QUEUE, REJECT, PREEMPT = GoalPolicy
DONE, FAILED, ENDED = MoveItErrorCode.SUCCESS, MoveItErrorCode.FAILURE, MoveItErrorCode.PREEMPTED
# Policy, what is done, the codes by number of the goal, the motions that were begun, and words of the first answer.
COURSES: dict[str, tuple[GoalPolicy, list[Callable[[ArmsDesk], Awaitable[None]]], dict[str, Any], list[str], str]] = {
    "goals of a joint run one after the other": (QUEUE, [submit("left", "left", "left")], {}, ["left"], ""),
    "in order of arrival": (
        QUEUE,
        [submit("left", "left"), finish("left", "left")],
        {"1": DONE, "2": DONE},
        ["left", "left"],
        "the arm is there",
    ),
    "the capacity is a limit": (QUEUE, [submit(*["left"] * 5)], {"5": FAILED}, ["left"], "3 goals are waiting"),
    "reject": (REJECT, [submit("left", "right", "right")], {"3": FAILED}, ["left", "right"], "goal 2"),
    "preempt": (
        PREEMPT,
        [submit("left", "right", "left")],
        {"1": ENDED},
        ["left", "left", "right"],
        "preempted by goal 3 from /goal",
    ),
    "preempt goals that wait": (
        QUEUE,
        [submit("left", "right", "left", "right"), submit("left", policy=PREEMPT)],
        {"1": ENDED, "3": ENDED},
        ["left", "left", "right"],
        "preempted by goal 5",
    ),
    "cancel one that is active": (
        QUEUE,
        [submit("left", "left"), end(lambda queue: queue.cancel("1", "enough"))],
        {"1": ENDED},
        ["left", "left"],
        "enough",
    ),
    "cancel one that waits": (
        QUEUE,
        [submit("left", "left"), end(lambda queue: queue.cancel("2", "enough"))],
        {"2": ENDED},
        ["left"],
        "enough",
    ),
    "cancel those of some joints": (
        QUEUE,
        [submit("left", "right", "left"), end(lambda queue: queue.cancel_all("enough", ["left"]))],
        {"1": ENDED, "3": ENDED},
        ["left", "right"],
        "enough",
    ),
    "a stop, and what comes after it": (
        QUEUE,
        [submit("left", "right", "left right"), end(lambda queue: queue.stop("stopped")), submit("left")],
        {"1": ENDED, "2": ENDED, "3": ENDED},
        ["left", "left", "right"],
        "stopped",
    ),
    "a goal of both arms waits for each": (
        QUEUE,
        [submit("left", "right", "left right"), finish("left")],
        {"1": DONE},
        ["left", "right"],
        "",
    ),
    "and begins after them": (
        QUEUE,
        [submit("left", "right", "left right"), finish("left", "right")],
        {"1": DONE, "2": DONE},
        ["left", "left right", "right"],
        "",
    ),
    "no goal overtakes one that waits": (QUEUE, [submit("left", "left right", "right")], {}, ["left"], ""),
    "closing answers all": (
        QUEUE,
        [submit("left", "left"), lambda desk: desk.queue.close(1.0)],
        {"1": ENDED, "2": ENDED},
        ["left"],
        "the server is shutting down",
    ),
}


@pytest.mark.parametrize(("policy", "acts", "codes", "begun", "words"), COURSES.values(), ids=COURSES.keys())
async def test_goals_take_their_course(
    policy: GoalPolicy,
    acts: list[Callable[[ArmsDesk], Awaitable[None]]],
    codes: dict[str, MoveItErrorCode],
    begun: list[str],
    words: str,
) -> None:
    desk = ArmsDesk(policy)
    for act in acts:
        await act(desk)
    assert dict(sorted(desk.codes())) == codes
    assert len(desk.answers) == len(codes)
    assert sorted(str(motion) for runner in desk.arms.runners.values() for motion in runner.asked) == begun
    assert all(words in answer.message for _, answer in desk.answers)
    assert desk.arms.stopped == [None] * ("stopped" in words or "shutting" in words)
    assert desk.states[0] == ("1", GoalState.QUEUED)
