from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from planners.pool import PlannerPool
from planners.problem import MoveItErrorCode, PlanningFailure, RecheckAnswer, RecheckQuestion
from planners.scene import Scene
from server.execution.scene_monitor import SceneMonitor
from tests.helpers.clock import FakeClock
from tests.helpers.fake_arm import settle
from tests.helpers.motions import smooth_move

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
    pool: PlannerPool = place  # type: ignore[assignment]
    monitor = SceneMonitor(pool, place)
    monitor.start(1, lambda: QUESTION, place.contacts.append)
    return monitor


@pytest.fixture
def place() -> Place:
    return Place()


async def test_an_unchanged_scene_is_not_checked(place: Place) -> None:
    watching(place)
    await settle()
    assert place.looked == []


async def test_a_change_in_the_way_is_reported_once(place: Place) -> None:
    watching(place)
    place.answer = RecheckAnswer(WALL, 0.5)
    place.change()
    await settle()
    place.change()
    await settle()
    assert place.contacts == [WALL]
    assert place.looked == [2]


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
    monitor.start(1, lambda: QUESTION, place.contacts.append)


async def test_starved_planners_are_asked_again() -> None:
    place = StarvedPlace(starved_s=4.5)
    watching_patiently(place)
    place.change()
    await settle()
    assert (place.looked, place.contacts) == ([2, 2, 2], [])


@pytest.mark.parametrize(
    ("answer", "contacts"), [(RecheckAnswer(None), 0), (PlanningFailure(MoveItErrorCode.CRASH, "the planner died"), 1)]
)
async def test_planners_that_answer_in_time_are_asked_once(
    answer: RecheckAnswer | PlanningFailure, contacts: int
) -> None:
    place = StarvedPlace(starved_s=0.0)
    place.answer = answer
    watching_patiently(place)
    place.change()
    await settle()
    assert (place.looked, len(place.contacts)) == ([2], contacts)


async def test_planners_that_are_silent_for_longer_than_the_arm_may_be_stop_the_motion() -> None:
    place = StarvedPlace(starved_s=60.0)
    watching_patiently(place)
    place.change()
    await settle()
    assert [contact.code for contact in place.contacts] == [MoveItErrorCode.COLLISION_CHECKING_UNAVAILABLE]
    assert place.looked == [2, 2, 2]


async def test_a_failed_check_counts_as_a_contact(place: Place) -> None:
    watching(place)
    place.answer = PlanningFailure(MoveItErrorCode.CRASH, "the planner died")
    place.change()
    await settle()
    assert [contact.code for contact in place.contacts] == [MoveItErrorCode.COLLISION_CHECKING_UNAVAILABLE]
    assert "the planner died" in place.contacts[0].message
