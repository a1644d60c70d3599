import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from planners.interface import Planners
from planners.problem import MoveItErrorCode, PlanningFailure, RecheckAnswer, RecheckQuestion
from planners.scene import Scene
from robot.arm import Arm
from robot.arm_group import ArmGroup
from robot.faults import Fault, FaultCode
from robot.messages import ArmState, Mode
from server.errors import RefusedError
from server.execution.monitors import CurrentState, SceneMonitor, check_ready
from tests.helpers.clock import FakeClock
from tests.helpers.fake_arm import settle
from tests.helpers.motions import smooth_move
from tests.helpers.moveit import rejection
from tests.helpers.robots import so101

ROBOT = so101()
NAMES = ("shoulder_pan", "gripper")

GOAL = np.zeros(6)
METAL_MAX_AGE_S, SIMULATED_MAX_AGE_S = 1.0, 5.0
STALLED = Fault(FaultCode.STALLED, "joint elbow_flex is stalled", "elbow_flex")

UNUSABLE = {
    "disconnected": (
        ArmState(0.0, Mode.DISCONNECTED, (), reason="unplugged"),
        MoveItErrorCode.COMMUNICATION_FAILURE,
        "the arm is not connected: unplugged",
    ),
    "refused by its checks": (
        ArmState(0.0, Mode.CONNECTED, (), reason="servo 3 is missing"),
        MoveItErrorCode.COMMUNICATION_FAILURE,
        "the arm is not ready: servo 3 is missing",
    ),
    "relaxed": (ArmState(0.0, Mode.RELAXED, (), goal_rad=GOAL), MoveItErrorCode.CONTROL_FAILED, "/arm/enable"),
    "fault": (
        ArmState(0.0, Mode.FAULT, (), goal_rad=GOAL, fault=STALLED),
        MoveItErrorCode.CONTROL_FAILED,
        "joint elbow_flex is stalled. Clear what blocks the joint, then reset the fault. .*/arm/reset_fault",
    ),
}


def current(**parts):
    return CurrentState(SimpleNamespace(state=ArmState(0.0, Mode.HOLDING, NAMES, **parts)), ROBOT)


def test_positions_are_those_that_the_arm_holds_and_not_those_it_droops_to():
    state = current(position_rad=np.array([0.1, 0.2]), goal_rad=np.array([0.3, 0.4]))
    assert state.positions_rad() == {"shoulder_pan": 0.3, "gripper": 0.4}


@dataclass
class Read:
    """An arm as it was read last."""

    state: ArmState
    state_age_s: float = 0.1
    state_max_age_s: float = METAL_MAX_AGE_S
    name: str = ""


@pytest.mark.parametrize(("state", "code", "words"), UNUSABLE.values(), ids=UNUSABLE.keys())
def test_an_arm_that_is_not_ready_names_reason_and_remedy(state: ArmState, code: MoveItErrorCode, words: str) -> None:
    with pytest.raises(RefusedError, match=words) as refused:
        check_ready(Read(state))
    assert refused.value.failure.code is code


HOLDING = ArmState(0.0, Mode.HOLDING, (), goal_rad=GOAL)
RELAXED = ArmState(0.0, Mode.RELAXED, (), goal_rad=GOAL)


def test_a_refusal_names_the_one_of_several_arms_that_is_not_ready() -> None:
    arms = {name: (cast("Arm", Read(state, name=name)), ()) for name, state in STATES_OF_SEVERAL.items()}
    refused = rejection(check_ready, ArmGroup(arms, ("leader",)))
    sentence = "the arm right is relaxed: enable it by the service /right/arm/enable first"
    assert (refused.code, refused.message) == (MoveItErrorCode.CONTROL_FAILED, sentence)
    assert rejection(check_ready, Read(RELAXED, name="right")).message == sentence
    faulty = rejection(check_ready, Read(UNUSABLE["fault"][0], name="right")).message
    assert faulty.startswith("the arm right has a fault: joint elbow_flex is stalled")
    assert faulty.endswith("The service that resets it is /right/arm/reset_fault.")


STATES_OF_SEVERAL = {"leader": RELAXED, "left": HOLDING, "right": RELAXED}


@pytest.mark.parametrize(("age_s", "max_age_s"), [(1.5, METAL_MAX_AGE_S), (5.5, SIMULATED_MAX_AGE_S)])
def test_an_old_state_refuses_motions(age_s: float, max_age_s: float) -> None:
    refused = rejection(check_ready, Read(HOLDING, age_s, max_age_s))
    assert refused.code is MoveItErrorCode.ROBOT_STATE_STALE
    assert refused.message == f"the last state of the arm is {age_s:.1f} s old (limit {max_age_s:g} s)"


QUESTION = RecheckQuestion("arm", smooth_move({"a": (0.0, 1.0)}, 1.0), {}, 0.0)
WALL = PlanningFailure(MoveItErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE, "would touch the wall")


class Place:
    """A scene that a test changes, and planners that look at it when the test lets them."""

    def __init__(self) -> None:
        self.scene = Scene(1)
        self.answer: RecheckAnswer | PlanningFailure = RecheckAnswer(None)
        self.looked: list[int] = []
        self.contacts: list[PlanningFailure] = []
        self.slow = False
        self.go_on = asyncio.Event()
        self._callback: Callable[[], None] = lambda: None

    def on_change(self, callback: Callable[[], None]) -> None:
        self._callback = callback

    def change(self) -> None:
        self.scene = Scene(self.scene.version + 1)
        self._callback()

    async def ask(self, _question: RecheckQuestion, scene: Scene) -> RecheckAnswer | PlanningFailure:
        self.looked.append(scene.version)
        if self.slow:
            await self.go_on.wait()
        return self.answer


def watching(place: Place) -> SceneMonitor:
    pool: Planners = place  # type: ignore[assignment]
    monitor = SceneMonitor(pool, place)
    monitor.start(1, lambda: (QUESTION,), place.contacts.append)
    return monitor


@pytest.fixture
def place() -> Place:
    return Place()


async def test_changes_during_a_check_are_checked_together(place: Place) -> None:
    watching(place)
    place.slow = True
    for _ in range(100):
        place.change()
        await settle()
    place.go_on.set()
    await settle()
    assert place.looked == [2, 101]
    assert place.contacts == []


async def test_a_motion_that_has_ended_is_checked_no_more(place: Place) -> None:
    monitor = watching(place)
    place.slow = True
    place.answer = RecheckAnswer(WALL, 0.5)
    place.change()
    await settle()
    monitor.stop()
    place.go_on.set()
    place.change()
    await settle()
    assert place.contacts == []
    assert place.looked == [2]


async def test_a_scene_that_changed_before_the_motion_began_is_checked(place: Place) -> None:
    place.change()
    watching(place)
    await settle()
    assert place.looked == [2]


class StarvedPlace(Place):
    """Planners that answer too late, each time that they are asked, for as long as a test says."""

    def __init__(self, starved_s: float) -> None:
        super().__init__()
        self.clock = FakeClock()
        self._until_s = self.clock() + starved_s

    async def ask(self, question: RecheckQuestion, scene: Scene) -> RecheckAnswer | PlanningFailure:
        self.clock.advance(2.0)
        answer = await super().ask(question, scene)
        return TOO_LATE if self.clock() < self._until_s else answer


TOO_LATE = PlanningFailure(MoveItErrorCode.TIMED_OUT, "the planner did not answer within 1 s and was given up")


def watching_patiently(place: StarvedPlace) -> None:
    monitor = SceneMonitor(place, place, 5.0, place.clock)  # type: ignore[arg-type]
    monitor.start(1, lambda: (QUESTION,), place.contacts.append)


async def test_planners_that_are_silent_for_longer_than_the_arm_may_be_stop_the_motion() -> None:
    place = StarvedPlace(starved_s=60.0)
    watching_patiently(place)
    place.change()
    await settle()
    assert [contact.code for contact in place.contacts] == [MoveItErrorCode.COLLISION_CHECKING_UNAVAILABLE]
    assert place.looked == [2, 2, 2]
