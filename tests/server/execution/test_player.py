import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace
from typing import Any

import pytest

from harness.waiting import until
from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import EMPTY_SCENE
from robot.messages import Outcome, Pace, PlaybackDirection
from server.execution import player
from server.execution.goal import Answer, ExecutionDeadline, Goal, GoalRequest, Progress, TimeLimits
from server.execution.monitors import Questions
from server.execution.motions import HORIZON_S
from server.execution.player import CODE_OF_OUTCOME, CheckedMotion, MotionsInProgress, Player
from tests.helpers.clock import FakeClock
from tests.helpers.fake_arm import JOINTS, FakeArm, StubbornArm, settle
from tests.helpers.motions import smooth_move
from tests.helpers.robots import so101

pytestmark = pytest.mark.stepped_time

MOTION = CheckedMotion("arm", smooth_move(dict.fromkeys(JOINTS, (0.0, 0.5)), 1.0), EMPTY_SCENE.version, "as planned")
CONTACT = PlanningFailure(
    MoveItErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE, "would touch the wall", {"pairs": ["wall"]}
)


def questions(from_s: float) -> Questions:
    return (MOTION.question(from_s, {}),)


class FakeSceneMonitor:
    """Monitors nothing until a test finds a contact."""

    def __init__(self) -> None:
        self.monitoring = False
        self.found: Any = None
        self.questions: Any = None

    def start(self, _version: int, questions: Any, on_contact: Any) -> None:
        self.monitoring, self.questions, self.found = True, questions, on_contact

    def stop(self) -> None:
        self.monitoring = False


LIMITS = TimeLimits(scaling=3.0)


class Stage:
    def __init__(self, arm: FakeArm | None = None) -> None:
        self.arm, self.scene_monitor = arm or FakeArm(), FakeSceneMonitor()
        self.clock = FakeClock()
        self.player = Player(self.arm, so101(), self.scene_monitor, MotionsInProgress(), self.clock)  # type: ignore[arg-type]
        self.news: list[Progress] = []
        self.goal = self.next_goal()
        self.running: asyncio.Task[Answer] | None = None

    def pass_time(self, seconds: float) -> None:
        """Let the same time pass on this machine's clock and on the arm's."""
        self.clock.advance(seconds)
        self.arm.pass_time(seconds)

    def next_goal(self) -> Goal:
        return Goal(
            "1",
            GoalRequest("/goal"),
            lambda _goal, progress: self.news.append(progress),
            deadline=ExecutionDeadline(LIMITS),
        )

    async def begin(self) -> None:
        self.running = asyncio.create_task(self.player.play(self.goal, MOTION, questions))
        await settle()

    async def answer(self) -> Answer:
        assert self.running is not None
        return await asyncio.wait_for(self.running, 5.0)


@pytest.fixture
async def stage() -> AsyncIterator[Stage]:
    made = Stage()
    await made.begin()
    return made


@pytest.mark.parametrize("outcome", [one for one in Outcome if one in CODE_OF_OUTCOME and one is not Outcome.STOPPED])
async def test_every_outcome_has_its_code_and_message(stage: Stage, outcome: Outcome) -> None:
    stage.arm.end(outcome, "that is how it went")
    answer = await stage.answer()
    assert answer == Answer(CODE_OF_OUTCOME[outcome], "that is how it went", {"outcome": outcome.value})
    assert not stage.scene_monitor.monitoring


async def test_a_motion_whose_goal_ends_by_an_error_is_braked() -> None:
    stage = Stage()

    def broken(_goal: Goal, _progress: Progress) -> None:
        raise ValueError("a bug")

    stage.running = asyncio.create_task(stage.player.play(Goal("1", GoalRequest("/goal"), broken), MOTION, questions))
    await settle()
    assert stage.arm.played == [MOTION.trajectory]
    await asyncio.sleep(2.0 * player.PROGRESS_PERIOD_S)
    with pytest.raises(ValueError, match="a bug"):
        await stage.answer()
    assert len(stage.arm.stops) == 1
    assert stage.arm.stops != [None]


async def test_a_contact_on_the_way_stops_the_motion_with_its_code_and_details(stage: Stage) -> None:
    stage.scene_monitor.found(CONTACT)
    stage.goal.cancel("too late")
    answer = await stage.answer()
    assert (answer.code, answer.details) == (CONTACT.code, CONTACT.details)
    assert answer.message == "would touch the wall; stopped half-way"


@pytest.mark.parametrize(("direction", "from_s"), [(PlaybackDirection.FORWARD, 0.25), (PlaybackDirection.BACK, 0.0)])
async def test_the_scene_monitor_asks_about_the_rest_of_the_motion_and_on_the_way_back_about_all(
    stage: Stage, direction: PlaybackDirection, from_s: float
) -> None:
    stage.pass_time(1.0)
    stage.arm.state = replace(stage.arm.state, fraction=0.25, pace=Pace(direction=direction))
    assert stage.scene_monitor.questions()[0].from_s == from_s


class WornDeadline(ExecutionDeadline):
    exceeded = "the arm did not end the motion"


async def test_a_motion_that_gets_nowhere_is_braked_and_names_the_joint_that_lags() -> None:
    stage = Stage()
    stage.goal.deadline = WornDeadline(LIMITS)
    await stage.begin()
    answer = await stage.answer()
    assert answer.code is MoveItErrorCode.TIMED_OUT
    assert answer.message.startswith("the arm did not end the motion; joint ")
    assert "is 0.000 rad behind; stopped half-way" in answer.message


LOOKS_S = 10.0 * player.PROGRESS_PERIOD_S
BRAKING_S = player.BRAKING_TIMEOUT_S
ALLOWED_S = LIMITS.allowed_s(MOTION.trajectory.duration_s)


async def test_the_end_of_an_outgoing_motion_is_awaited_by_the_arms_clock() -> None:
    stubborn = Stage(StubbornArm())
    await stubborn.begin()
    stubborn.goal.cancel("preempted by a test", replaced=True)
    await stubborn.answer()
    resting = asyncio.create_task(stubborn.player.stop_outgoing())
    await asyncio.sleep(LOOKS_S)
    stubborn.arm.pass_time(0.9 * BRAKING_S)
    await asyncio.sleep(LOOKS_S)
    assert not resting.done()
    stubborn.arm.pass_time(0.2 * BRAKING_S)
    await asyncio.wait_for(resting, 5.0)


async def test_a_silent_arm_is_not_awaited() -> None:
    stubborn = Stage(StubbornArm())
    await stubborn.begin()
    stubborn.pass_time(1.1 * ALLOWED_S)
    await asyncio.sleep(LOOKS_S)
    stubborn.arm.state_age_s = 5.1
    assert (await stubborn.answer()).code is MoveItErrorCode.COMMUNICATION_FAILURE


async def test_the_pauses_of_all_motions_of_a_goal_count_together() -> None:
    stage = Stage()
    for _ in range(2):
        await stage.begin()
        stage.arm.state = replace(stage.arm.state, pace=Pace(1.0, PlaybackDirection.PAUSED))
        stage.pass_time(0.6 * LIMITS.paused_s)
        await asyncio.sleep(LOOKS_S)
        stage.arm.end()
        answer = await stage.answer()
    assert answer.code is MoveItErrorCode.TIMED_OUT
    assert answer.message.startswith("the motion was paused or going back for 720 s (limit 600 s)")


async def test_an_outgoing_motion_goes_on_until_another_replaces_it(stage: Stage) -> None:
    stage.pass_time(1.0)
    stage.arm.show(0.4)
    stage.goal.cancel("preempted by a test", replaced=True)
    assert await stage.answer() == Answer(MoveItErrorCode.PREEMPTED, "preempted by a test")
    outgoing: Any = stage.player.outgoing
    point = outgoing.splice_point(stage.clock(), HORIZON_S)
    assert stage.arm.stops == []
    stage.running = asyncio.create_task(stage.player.play(stage.next_goal(), MOTION, questions, from_s=point.from_s))
    await settle()
    assert stage.arm.continued == [point.from_s]
    assert outgoing.ended.done()


async def test_an_outgoing_motion_is_braked_when_none_replaces_it(stage: Stage) -> None:
    stage.goal.cancel("preempted by a test", replaced=True)
    await stage.answer()
    await until(lambda: stage.arm.stops)


async def test_a_braking_motion_is_not_replaced(stage: Stage) -> None:
    stage.goal.cancel("a test")
    stage.goal.cancel("too late", replaced=True)
    assert (await stage.answer()).message == "a test; stopped half-way"
