from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest

from planners.cluster.cluster_worker import MAX_TRIES, ClusterWorker
from planners.cluster.messages import Missing
from planners.problem import MoveItErrorCode, PlanningFailure, Request, StateAnswer
from planners.scene import EMPTY_SCENE, Scene
from tests.helpers.requests import EASY, STATE

distributed = pytest.importorskip("distributed", reason="the extra [dask] is not installed")

MISSING = Missing("tcp://worker:1", robot=False)
DONE = StateAnswer(valid=True, problems=())


class Future:
    def __init__(self, answer: object) -> None:
        self._answer = answer
        self.cancelled = False

    async def result(self) -> object:
        if self._answer is None:
            await asyncio.sleep(60.0)
        if isinstance(self._answer, Exception):
            raise self._answer
        return self._answer

    def done(self) -> bool:
        return self._answer is not None

    async def cancel(self) -> None:
        self.cancelled = True


class Link:
    """Gives the answers of a test one after the other."""

    def __init__(self, *answers: object) -> None:
        self.answers = list(answers)
        self.futures: list[Future] = []
        self.open = True
        self.asked_of: list[str | None] = []
        self.supplied: list[Missing] = []

    def submit(self, request: Request, scene: Scene, worker: str | None) -> Future:
        self.asked_of.append(worker)
        self.futures.append(Future(self.answers.pop(0)))
        return self.futures[-1]

    async def supply(self, missing: Missing, scene: Scene) -> None:
        self.supplied.append(missing)


def worker_of(link: Link) -> ClusterWorker:
    return ClusterWorker(cast("Any", link))


async def failure_of(*answers: object, request: Request = STATE) -> PlanningFailure:
    answer = await worker_of(Link(*answers)).ask(request, EMPTY_SCENE)
    assert isinstance(answer, PlanningFailure)
    return answer


async def test_it_is_for_motions_only_and_usable_while_the_scheduler_is_in_reach() -> None:
    link = Link()
    worker = worker_of(link)
    assert not worker.takes_questions
    assert worker.usable
    link.open = False
    assert not worker.usable


async def test_it_does_not_tell_what_its_machine_waits_for_a_core() -> None:
    assert worker_of(Link()).run_delay_s() is None


async def test_a_worker_that_lacks_something_gets_it_and_is_asked_again() -> None:
    link = Link(MISSING, DONE)
    assert await worker_of(link).ask(STATE, EMPTY_SCENE) is DONE
    assert link.supplied == [MISSING]
    assert link.asked_of == [None, MISSING.worker]


async def test_workers_that_lack_something_for_ever_are_given_up() -> None:
    failure = await failure_of(*[MISSING] * MAX_TRIES)
    assert failure.code is MoveItErrorCode.COMMUNICATION_FAILURE
    assert str(MAX_TRIES) in failure.message


async def test_an_answer_of_the_wrong_kind_is_a_crash() -> None:
    failure = await failure_of(DONE, request=EASY)
    assert failure.code is MoveItErrorCode.CRASH
    assert "answered a PlanningProblem with StateAnswer" in failure.message


async def test_a_failure_that_the_planner_has_found_is_handed_on() -> None:
    found = PlanningFailure(MoveItErrorCode.GOAL_IN_COLLISION, "it touches")
    assert await failure_of(found) is found


@pytest.mark.parametrize(
    "error", [OSError("no route"), TimeoutError(), distributed.CancelledError("scheduler-connection-lost")]
)
async def test_what_cannot_be_reached_is_a_failure_of_communication(error: Exception) -> None:
    failure = await failure_of(error)
    assert failure.code is MoveItErrorCode.COMMUNICATION_FAILURE
    assert (str(error) or "TimeoutError") in failure.message


async def test_a_bug_there_is_a_crash_here_and_nothing_worse(caplog: pytest.LogCaptureFixture) -> None:
    failure = await failure_of(ValueError("a bug"))
    assert failure.code is MoveItErrorCode.CRASH
    assert "ValueError: a bug" in failure.message
    assert "a bug" in caplog.text


async def test_a_request_on_which_worker_after_worker_dies_is_a_crash() -> None:
    failure = await failure_of(distributed.KilledWorker("task", None, 3))
    assert failure.code is MoveItErrorCode.CRASH
    assert "4 workers" in failure.message


@pytest.mark.parametrize("how", [ClusterWorker.cancel, ClusterWorker.kill])
async def test_a_request_that_is_given_up_is_taken_back(how: Any) -> None:
    link = Link(None, DONE)
    worker = worker_of(link)
    asking = asyncio.create_task(worker.ask(STATE, EMPTY_SCENE))
    await asyncio.sleep(0)
    asking.cancel()
    await asyncio.wait([asking])
    await how(worker)
    assert link.futures[0].cancelled
    assert await worker.ask(STATE, EMPTY_SCENE) is DONE


async def test_nothing_is_taken_back_from_a_scheduler_that_is_gone() -> None:
    link = Link(None)
    worker = worker_of(link)
    asking = asyncio.create_task(worker.ask(STATE, EMPTY_SCENE))
    await asyncio.sleep(0)
    link.open = False
    await worker.cancel()
    assert not link.futures[0].cancelled
    asking.cancel()
    await asyncio.wait([asking])
