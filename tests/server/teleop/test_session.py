"""A following in progress: when it steps, and what it tells of its latency."""

import asyncio
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from typing import cast

import pytest

from harness.waiting import TIMEOUT_S
from planners.problem import MoveItErrorCode
from planners.servo.question import JointVelocities, ServoAnswer, ServoLimits, ServoQuestion
from robot.description.joined import prefixed
from server.execution.executor import GoalExecutors
from server.execution.goal import Answer, Goal, GoalPolicy, GoalRequest, GoalState, Progress
from server.execution.motions import Positions
from server.execution.queue import GoalQueue
from server.graph.topics import Graph
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.servo.servo_loop import ServoSetup
from server.teleop import session as sessions
from server.teleop.following import FollowingPhase
from server.teleop.leader import JitterBuffer, LeaderSample, joint_map
from server.teleop.session import Follower, FollowingSession, FollowingState
from tests.helpers.clock import FakeClock
from tests.helpers.fake_arm import JOINTS, ROBOT, FakeArm
from tests.helpers.moveit import REGISTRY, goal_context, planning_of

STEERED = ROBOT.groups["arm"].joints
PLANNING_S = 0.002


def go_to(_positions: Positions, _scaling: float) -> Goal:
    """Arrive at once."""
    goal = Goal("1", GoalRequest("/goal"))
    goal.answered.set_result(Answer(MoveItErrorCode.SUCCESS, ""))
    return goal


def session_of(
    planning: PlanningContext, arm: FakeArm, samples: JitterBuffer, told: list[FollowingState], name: str = ""
) -> FollowingSession:
    """Return a following by the arm, or by the arm with this name of several, whose ramps arrive at once."""
    prefix, robot = name and f"{name}_", planning.robot
    group = robot.groups[f"{prefix}arm"]
    setup = ServoSetup(group.name, group.joints, f"{prefix}gripper_frame_link", ServoLimits(), 0.02, 1000.0)
    # The queue is never started: no ramp is played.
    queue = GoalQueue(cast("GoalExecutors", None), GoalPolicy.QUEUE, 1)
    context = goal_context(Graph(REGISTRY), arm, planning, queue)
    if name:
        context = replace(context, robot=prefixed(ROBOT, name))
    follower = Follower(name, prefix, context, setup, None, go_to)
    return FollowingSession(follower, joint_map(robot, prefix, JOINTS), samples, told.append, lambda _targets: None)


class Rig:
    """A following whose planners take 2 ms for an answer."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        self.samples = JitterBuffer({}, max_delay_s=0.0)
        self.questions: list[ServoQuestion] = []
        self.told: list[FollowingState] = []
        self.arm = FakeArm()
        planning = planning_of(self.arm, pool=self, graph=Graph(REGISTRY, self.clock))
        self.session = session_of(planning, self.arm, self.samples, self.told)

    def read(self, elbow_rad: float, late_s: float = 0.0) -> None:
        """Have the leader read and its sample come."""
        stamp_s = self.clock()
        self.clock.advance(late_s)
        self.samples.add(LeaderSample(stamp_s, dict.fromkeys(JOINTS, 0.0) | {"elbow_flex": elbow_rad}), self.clock())
        self.session.take_sample()

    async def until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(TIMEOUT_S):
            while not condition():
                await asyncio.sleep(0)

    async def ask(self, question: ServoQuestion, _scene: object) -> ServoAnswer:
        self.questions.append(question)
        self.clock.advance(PLANNING_S)
        await asyncio.sleep(0)
        return ServoAnswer(dict.fromkeys(STEERED, 0.0))


@pytest.fixture
async def rig(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Rig]:
    """One whose period passes for no test: it steps with its samples alone."""
    monkeypatch.setattr(sessions, "PERIOD_S", 1000.0)
    made = Rig()
    yield made
    await made.session.close()


async def begin(rig: Rig) -> None:
    """Start the following and wait until the first answer has reached the arm."""
    rig.read(0.1)
    rig.session.start()
    assert rig.told[-1].phase is FollowingPhase.RAMPING, "before the start is answered"
    await rig.until(lambda: rig.session.following.phase is not FollowingPhase.RAMPING)
    rig.read(0.1)
    await rig.until(lambda: len(rig.arm.setpoints) == 1)


async def test_a_sample_is_followed_when_it_comes_and_the_latency_counts_from_its_reading(rig: Rig) -> None:
    await begin(rig)
    rig.clock.advance(0.01)
    rig.read(0.2, late_s=0.004)
    await rig.until(lambda: len(rig.questions) == 2)
    command = rig.questions[1].command
    assert isinstance(command, JointVelocities)
    assert command.velocity_rad_s["elbow_flex"] > 0.0
    await rig.until(lambda: len(rig.arm.setpoints) == 2)
    rig.session._show_state()
    assert rig.told[-1].latency_s == pytest.approx(0.004 + PLANNING_S)


async def test_a_follower_that_does_not_set_out_for_the_leader_within_two_seconds_gives_up(rig: Rig) -> None:
    waiting = Goal("1", GoalRequest("/goal"))
    waiting.progress = Progress(GoalState.PLANNED, "waits for the motion of the other arm")
    rig.session._go_to = lambda _positions, _scaling: waiting
    rig.read(0.1)
    rig.session.start()
    await rig.until(lambda: rig.session._ramp is waiting)
    for _ in range(41):
        assert not rig.session.following.ended
        rig.clock.advance(0.05)
        rig.read(0.1)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
    await rig.until(lambda: rig.session.following.ended)
    assert "has not set out for the leader within 2 s: waits for the motion" in rig.session.following.message


async def test_a_leader_that_is_far_ahead_is_followed_by_a_planned_motion(rig: Rig) -> None:
    await begin(rig)
    asked = len(rig.questions)
    rig.clock.advance(1.0)
    rig.read(1.5)
    await rig.until(lambda: rig.session._interrupted != "")
    assert "elbow_flex is 1.50 rad behind the leader (limit 1.2 rad)" in rig.session._interrupted
    rig.read(1.5)
    await rig.until(lambda: rig.session.following.phase is not FollowingPhase.FOLLOWING)
    assert len(rig.questions) == asked


async def test_a_leader_that_speaks_in_degrees_leads_nowhere(rig: Rig) -> None:
    rig.read(30.0)
    rig.session.start()
    await rig.until(lambda: rig.session.following.ended)
    assert "beyond its range of -1.69 to 1.69 rad: positions are in radians" in rig.session.following.message
    assert rig.arm.setpoints == []
