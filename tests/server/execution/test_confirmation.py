import asyncio
from typing import Any

import pytest

from harness.clients import values_of
from harness.waiting import TIMEOUT_S
from planners.problem import MoveItErrorCode
from server.execution import confirmation
from server.execution.goal import Goal, GoalRequest, GoalState, Progress
from server.execution.motions import Performed, PlannedMotion
from server.graph.permissions import Node
from server.graph.topics import Graph
from tests.helpers.fake_arm import settle
from tests.helpers.graph import answered, listen
from tests.helpers.moveit import REGISTRY

CLIENT = Node("client")


class Gate:
    def __init__(self, timeout_s: float = 60.0) -> None:
        self.graph = Graph(REGISTRY)
        self.confirmation = confirmation.Confirmation(self.graph, enabled=False, timeout_s=timeout_s)

    def say(self, data: bool | str) -> None:
        """Decide about the goal that waits, or approve one by its id."""
        self.graph.publish(
            CLIENT, confirmation.APPROVE_TOPIC if isinstance(data, str) else confirmation.CONFIRM_TOPIC, {"data": data}
        )

    async def ask(self, *, proposed: bool = False) -> asyncio.Task[Any]:
        task = asyncio.create_task(self.confirmation.wait(goal(proposed=proposed), PLANNED))
        await settle()
        return task


@pytest.fixture
async def gate() -> Gate:
    return Gate()


PLANNED = Performed({}, methods=("RRTConnect",))


def goal(number: str = "7", on_progress: Any = None, *, proposed: bool = False) -> Goal:
    motion = PlannedMotion((), frozenset(), confirm=True, proposed=proposed)
    return Goal(
        number, GoalRequest("/moveit_goal", motion, client="agent (10.0.0.5:5)"), on_progress or (lambda *_: None)
    )


async def test_a_client_that_hears_that_a_plan_waits_can_decide_at_once(gate: Gate) -> None:
    def decide(_goal: Goal, progress: Progress) -> None:
        assert progress.state is GoalState.PLANNED
        gate.say(True)

    assert await gate.confirmation.wait(goal(on_progress=decide), PLANNED) is None


async def test_a_plan_that_is_not_confirmed_in_time_is_discarded() -> None:
    for proposed, topic in ((False, confirmation.CONFIRM_TOPIC), (True, confirmation.APPROVE_TOPIC)):
        answer: Any = await Gate(timeout_s=0.01).confirmation.wait(goal(proposed=proposed), PLANNED)
        assert answer.code is MoveItErrorCode.TIMED_OUT
        assert answer.message.endswith(f"not confirmed on {topic} within 0.01 s")


async def test_a_decision_counts_only_for_the_plan_that_waits(gate: Gate, caplog: pytest.LogCaptureFixture) -> None:
    gate.say(True)
    assert "no goal waits" in caplog.text
    task = await gate.ask()
    assert not task.done()
    gate.say(True)
    gate.say(False)
    assert await task is None


async def test_a_proposal_is_approved_by_its_id_alone(gate: Gate, caplog: pytest.LogCaptureFixture) -> None:
    gate.say("7")
    assert f"{confirmation.APPROVE_TOPIC}: ignored, no goal waits" in caplog.text
    task = await gate.ask(proposed=True)
    # A click that was meant for the goal before, and a client that names none.
    gate.say("6")
    gate.say(True)
    await settle()
    assert not task.done()
    assert "goal 7 waits, not '6'" in caplog.text
    assert f"goal 7 is approved on {confirmation.APPROVE_TOPIC}" in caplog.text
    gate.say("7")
    gate.say("7")
    assert await task is None
    gate.say(False)
    task = await gate.ask(proposed=True)
    gate.say(False)
    assert (await task).code is MoveItErrorCode.PREEMPTED


async def test_the_goal_that_waits_is_latched(gate: Gate) -> None:
    def request() -> dict[str, Any]:
        status = listen(gate.graph, confirmation.APPROVAL_TOPIC)[-1]
        return {**status, **values_of(status)}

    assert (request()["hardware_id"], request()["message"]) == ("", "no goal waits")
    task = await gate.ask(proposed=True)
    waiting = request()
    assert (waiting["hardware_id"], waiting["client"], waiting["proposed"]) == ("7", "agent (10.0.0.5:5)", "true")
    assert waiting["message"].startswith("goal 7 of agent (10.0.0.5:5) from /moveit_goal waits: ")
    task.cancel()
    await asyncio.wait([task])
    assert request()["hardware_id"] == ""


async def test_the_service_switches_the_mode_and_goals_of_several_groups_wait_one_after_the_other(gate: Gate) -> None:
    assert answered(gate.graph, confirmation.CONFIRM_MODE_SERVICE, data=True).values["success"]
    assert gate.confirmation.enabled
    first, second = (asyncio.create_task(gate.confirmation.wait(goal(number), PLANNED)) for number in "12")
    for waiting in (first, second):
        await settle()
        gate.say(True)
        assert await asyncio.wait_for(waiting, TIMEOUT_S) is None
