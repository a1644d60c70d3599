import asyncio
import functools
import gc
import weakref
from collections import defaultdict
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from operator import methodcaller
from typing import Any, TypeAlias

import pytest

from planners.problem import MoveItErrorCode, PlanningFailure
from server.execution.goal import Answer, Goal, GoalPolicy, GoalRequest, GoalState, Progress, TimeLimits
from server.execution.queue import GoalListener, GoalQueue, RunningGoal
from tests.helpers.fake_arm import settle
from tests.helpers.goal_runner import GoalRunner

LEFT, RIGHT, BOTH = "left", "right", "left right"


class Move(str):
    """A motion of the joints that its words name."""

    __slots__ = ()

    @property
    def joints(self) -> frozenset[str]:
        return frozenset(self.split())


class BrokenError(ValueError):
    """A motion for which its executor raises it."""

    joints = frozenset({LEFT})


class ScriptedRunner(GoalRunner):
    async def run(self, goal: Goal) -> Answer:
        goal.report(Progress(GoalState.PLANNING, "planning"))
        if isinstance(goal.request.motion, Exception):
            raise goal.request.motion
        return await super().run(goal)


class DeafRunner(ScriptedRunner):
    """Ends nothing, whatever it is told."""

    def cancel(self, reason: str) -> None:
        self.stopped.append(reason)


class Desk(GoalListener):
    """A queue of two arms, their executors, and all that it told."""

    time_limits = TimeLimits()

    def __init__(self, policy: GoalPolicy = GoalPolicy.QUEUE, runner: type[ScriptedRunner] = ScriptedRunner) -> None:
        self.runners: dict[frozenset[str], ScriptedRunner] = defaultdict(runner)
        self.stopped: list[Any] = []
        self.states: list[tuple[str, GoalState]] = []
        self.answers: list[tuple[str, Answer]] = []
        self.replaced: list[bool] = []
        self.queue = GoalQueue(self, policy, 3)
        self.queue.listeners.append(self)
        self.queue.start()

    def on_progress(self, goal: Goal, progress: Progress) -> None:
        self.states.append((goal.goal_id, progress.state))

    def on_answer(self, goal: Goal, answer: Answer) -> None:
        self.answers.append((goal.goal_id, answer))
        self.replaced.append(goal.replaced)

    def last_stop(self, _joints: frozenset[str]) -> int:
        return 0

    def executor(self, joints: frozenset[str]) -> ScriptedRunner:
        return self.runners[joints]

    def stop(self, joints: Iterable[str] | None = None) -> None:
        self.stopped.append(joints)

    def brake(self) -> None:
        self.stopped.append(None)

    async def submit(self, *motions: object, **fields: Any) -> None:
        """Submit goals; each is begun, or waits, before the next one comes."""
        for motion in motions:
            self.queue.submit(GoalRequest("/goal", Move(motion) if isinstance(motion, str) else motion, **fields))
            await settle()

    async def finish(self, *names: str) -> None:
        """Reach the active goals of some joints, one after the other, and let the next ones begin."""
        for name in names:
            self.runners[Move(name).joints].finish()
            await settle()

    async def end(self, method: str, *arguments: object) -> None:
        getattr(self.queue, method)(*arguments)
        await settle()

    async def close(self) -> None:
        await self.queue.close(0.1)

    @property
    def asked(self) -> list[str]:
        return sorted(str(motion) for runner in self.runners.values() for motion in runner.asked)

    @property
    def codes(self) -> list[tuple[str, MoveItErrorCode]]:
        return [(goal_id, answer.code) for goal_id, answer in self.answers]


@pytest.fixture
async def desk() -> AsyncIterator[Desk]:
    made = Desk()
    yield made
    await made.close()


async def test_a_rejected_goal_is_answered_and_freed_without_the_garbage_collector(desk: Desk) -> None:
    gc.disable()
    try:
        failure = PlanningFailure(MoveItErrorCode.FAILURE, "refused")
        ended = weakref.ref(desk.queue.reject(GoalRequest("/goal"), failure))
        assert ended() is None
    finally:
        gc.enable()
    assert desk.codes == [("1", MoveItErrorCode.FAILURE)]


async def test_the_active_goal_is_told_with_its_client_its_time_left_and_those_behind_it(desk: Desk) -> None:
    assert desk.queue.running() is None
    await desk.submit(LEFT, client="unity")
    assert desk.queue.running() == RunningGoal("goal 1 of unity from /goal", None, 0)
    await desk.submit(LEFT)
    desk.executor(Move(LEFT).joints).report(Progress(GoalState.EXECUTING, "", 0.25, 3.0))
    assert desk.queue.running() == RunningGoal("goal 1 of unity from /goal", 3.0, 1)
    await desk.finish(LEFT)
    assert desk.queue.running() == RunningGoal("goal 2 from /goal", None, 0)


async def test_a_goal_is_told_how_many_are_ahead_of_it(desk: Desk) -> None:
    assert desk.queue.busy() == ""
    goals = [desk.queue.submit(GoalRequest("/goal", Move(LEFT))) for _ in range(3)]
    waiting = [goal.progress.message for goal in goals if goal.progress is not None]
    # Also in the same turn of the event loop.
    assert desk.queue.submit(GoalRequest("/goal", Move(LEFT), policy=REJECT)).answered.done()
    assert waiting == ["next", "1 goals ahead", "2 goals ahead"]
    await settle()
    assert desk.queue.busy() == "goal 1 from /goal is worked on"


async def test_a_bug_in_the_runner_costs_its_goal_only(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    await desk.submit(BrokenError("broken"), LEFT)
    await desk.finish(LEFT)
    assert desk.codes == [("1", MoveItErrorCode.FAILURE), ("2", MoveItErrorCode.SUCCESS)]
    assert "broken" in desk.answers[0][1].message
    assert "goal 1" in caplog.text


async def test_a_bug_in_a_listener_costs_no_other_goal(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    def broken(_news: object) -> None:
        raise ValueError("broken listener")

    await desk.submit(LEFT, on_progress=broken, on_answer=broken)
    await desk.submit(LEFT)
    await desk.finish(LEFT)
    assert desk.asked == [LEFT, LEFT]
    assert desk.codes == [("1", MoveItErrorCode.SUCCESS)]
    assert "broken listener" in caplog.text


@pytest.mark.parametrize("cut_short", [True, False])
async def test_closing_answers_a_goal_that_does_not_end_even_if_closing_is_cut_short(*, cut_short: bool) -> None:
    desk = Desk(runner=DeafRunner)
    await desk.submit(LEFT)
    closing = asyncio.create_task(desk.queue.close(60.0 if cut_short else 0.01))
    await settle()
    if cut_short:
        closing.cancel()
    await asyncio.wait([closing])
    await settle()
    assert not [task for task in asyncio.all_tasks() if task.get_name() == "goal 1"]
    assert desk.codes == [("1", MoveItErrorCode.PREEMPTED)]
    assert cut_short or "did not come to rest in time" in desk.answers[0][1].message


@pytest.mark.stepped_time
async def test_closing_waits_no_longer_than_until_the_active_goal_has_ended() -> None:
    desk = Desk(runner=DeafRunner)
    await desk.submit(LEFT)
    closing = asyncio.create_task(desk.queue.close(60.0))
    await asyncio.sleep(1.0)
    assert not closing.done()
    await desk.finish(LEFT)
    await closing
    assert asyncio.get_running_loop().time() < 2.0


Act: TypeAlias = Callable[[Desk], Awaitable[None]]
submit, finish, end = (functools.partial(methodcaller, name) for name in ("submit", "finish", "end"))
QUEUE, REJECT, PREEMPT = GoalPolicy
DONE, FAILED, ENDED = MoveItErrorCode.SUCCESS, MoveItErrorCode.FAILURE, MoveItErrorCode.PREEMPTED
# Policy, what is done, the codes by number of the goal, the motions that were begun, and words of the answers.
COURSES: list[tuple[GoalPolicy, list[Act], dict[str, MoveItErrorCode], list[str], str]] = [
    # Goals of a joint run one after the other, in order of arrival, and so many at most wait.
    (QUEUE, [submit(LEFT, LEFT, LEFT)], {}, [LEFT], ""),
    (QUEUE, [submit(LEFT, LEFT), finish(LEFT, LEFT)], {"1": DONE, "2": DONE}, [LEFT, LEFT], "the arm is there"),
    (QUEUE, [submit(*[LEFT] * 5)], {"5": FAILED}, [LEFT], "3 goals are waiting"),
    # The policy counts for goals of the same joints, also for those that wait.
    (REJECT, [submit(LEFT, RIGHT, RIGHT)], {"3": FAILED}, [LEFT, RIGHT], "goal 2"),
    (PREEMPT, [submit(LEFT, RIGHT, LEFT)], {"1": ENDED}, [LEFT, LEFT, RIGHT], "preempted by goal 3 from /goal"),
    (
        QUEUE,
        [submit(LEFT, RIGHT, LEFT, RIGHT), submit(LEFT, policy=PREEMPT)],
        {"1": ENDED, "3": ENDED},
        [LEFT, LEFT, RIGHT],
        "preempted by goal 5",
    ),
    # A goal is cancelled while it is active or waits; so are all of some joints, or all, and what comes later is not.
    (QUEUE, [submit(LEFT, RIGHT, LEFT), end("cancel", "1", "enough")], {"1": ENDED}, [LEFT, LEFT, RIGHT], "enough"),
    (QUEUE, [submit(LEFT, LEFT), end("cancel", "2", "enough")], {"2": ENDED}, [LEFT], "enough"),
    (QUEUE, [submit(LEFT, LEFT), end("cancel", "2", ""), finish(LEFT)], {"1": DONE, "2": ENDED}, [LEFT], ""),
    (
        QUEUE,
        [submit(LEFT, RIGHT, LEFT), end("cancel_all", "enough", [LEFT])],
        {"1": ENDED, "3": ENDED},
        [LEFT, RIGHT],
        "enough",
    ),
    (
        QUEUE,
        [submit(LEFT, RIGHT, BOTH), end("stop", "stopped"), submit(LEFT)],
        {"1": ENDED, "2": ENDED, "3": ENDED},
        [LEFT, LEFT, RIGHT],
        "stopped",
    ),
    (
        QUEUE,
        [submit(LEFT, LEFT), Desk.close, submit(RIGHT)],
        {"1": ENDED, "2": ENDED, "3": ENDED},
        [LEFT],
        "the server is shutting down",
    ),
    # A goal of both arms waits for each, begins after them, and is not overtaken.
    (QUEUE, [submit(LEFT, RIGHT, BOTH), finish(LEFT)], {"1": DONE}, [LEFT, RIGHT], ""),
    (QUEUE, [submit(LEFT, RIGHT, BOTH), finish(LEFT, RIGHT)], {"1": DONE, "2": DONE}, [LEFT, BOTH, RIGHT], ""),
    (QUEUE, [submit(LEFT, BOTH, RIGHT)], {}, [LEFT], ""),
]


@pytest.mark.parametrize(("policy", "acts", "codes", "begun", "words"), COURSES)
async def test_goals_take_their_course(
    policy: GoalPolicy, acts: list[Act], codes: dict[str, MoveItErrorCode], begun: list[str], words: str
) -> None:
    desk = Desk(policy)
    for act in acts:
        await act(desk)
    assert dict(sorted(desk.codes)) == codes
    assert len(desk.answers) == len(codes)
    assert desk.asked == begun
    assert all(words in answer.message for _, answer in desk.answers)
    assert desk.replaced == ["preempted" in words] * len(codes)
    assert desk.stopped == [None] * ("stopped" in words or "shutting" in words)
    assert desk.states[0] == ("1", GoalState.QUEUED)
