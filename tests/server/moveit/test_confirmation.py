from __future__ import annotations

import asyncio
from typing import Any

import pytest

from planners.problem import MoveItErrorCode
from protocol.errors import MessageError
from protocol.registry import Registry
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.confirmation import CONFIRM_TOPIC, MODE_SERVICE, Confirmation

REGISTRY = Registry.load()
CLIENT = Node("client")


class Gate:
    def __init__(self, timeout_s: float = 60.0) -> None:
        self.graph = Graph(REGISTRY)
        self.confirmation = Confirmation(self.graph, wanted=False, timeout_s=timeout_s)
        self.confirmation.open()

    def say(self, msg: dict[str, Any]) -> None:
        self.graph.publish(CLIENT, CONFIRM_TOPIC, msg)


@pytest.fixture
async def gate() -> Gate:
    return Gate()


async def asked(gate: Gate) -> asyncio.Task[Any]:
    task = asyncio.create_task(gate.confirmation.ask())
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    return task


async def test_true_lets_the_goal_go_on(gate: Gate) -> None:
    task = await asked(gate)
    gate.say({"data": True})
    assert await task is None


async def test_false_discards_the_plan(gate: Gate) -> None:
    task = await asked(gate)
    gate.say({"data": False})
    answer = await task
    assert answer.code is MoveItErrorCode.PREEMPTED
    assert CONFIRM_TOPIC in answer.message


async def test_a_plan_nobody_confirms_in_time_is_given_up() -> None:
    answer = await Gate(timeout_s=0.01).confirmation.ask()
    assert answer is not None
    assert answer.code is MoveItErrorCode.TIMED_OUT
    assert "within 0.01 s" in answer.message


async def test_a_word_counts_only_for_the_plan_that_waits(gate: Gate, caplog: pytest.LogCaptureFixture) -> None:
    gate.say({"data": True})
    assert "no goal waits" in caplog.text
    task = await asked(gate)
    assert not task.done()
    gate.say({"data": True})
    gate.say({"data": False})
    assert await task is None


async def test_a_message_of_the_wrong_form_confirms_nothing(gate: Gate, caplog: pytest.LogCaptureFixture) -> None:
    task = await asked(gate)
    with pytest.raises(MessageError):
        gate.say({"data": "yes"})
    assert CONFIRM_TOPIC in caplog.text
    assert not task.done()
    task.cancel()


async def test_the_service_switches_the_mode(gate: Gate) -> None:
    answers: list[Any] = []
    gate.graph.services.call(CLIENT, MODE_SERVICE, {"data": True}, answers.append)
    assert gate.confirmation.wanted
    assert answers[0].values["success"]
