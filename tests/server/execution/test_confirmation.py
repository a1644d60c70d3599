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

    def confirm(self, goal_id: str = "7") -> None:
        self.graph.publish(CLIENT, confirmation.APPROVE_TOPIC, {"data": goal_id})

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
        gate.confirm()

    assert await gate.confirmation.wait(goal(on_progress=decide), PLANNED) is None


async def test_a_plan_that_is_not_confirmed_in_time_is_discarded() -> None:
    answer: Any = await Gate(timeout_s=0.01).confirmation.wait(goal(), PLANNED)
    assert answer.code is MoveItErrorCode.TIMED_OUT
    assert answer.message.endswith(f"not confirmed on {confirmation.APPROVE_TOPIC} within 0.01 s")


async def test_a_plan_is_confirmed_by_its_goals_id_alone(gate: Gate, caplog: pytest.LogCaptureFixture) -> None:
    gate.confirm()
    assert f"{confirmation.APPROVE_TOPIC}: ignored, no goal waits" in caplog.text
    task = await gate.ask()
    # A click that was meant for the goal before.
    gate.confirm("6")
    await settle()
    assert not task.done()
    assert "goal 7 waits, not '6'" in caplog.text
    gate.confirm()
    gate.confirm()
    assert await task is None
    # Nor does it count for a plan that waits later.
    gate.confirm()
    task = await gate.ask()
    assert not task.done()
    task.cancel()


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
    for number, waiting in (("1", first), ("2", second)):
        await settle()
        gate.confirm(number)
        assert await asyncio.wait_for(waiting, TIMEOUT_S) is None
