from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest

from planners.problem import MoveItErrorCode
from protocol.errors import MessageError
from protocol.registry import Registry
from robot import model
from server.goal_queue import Answer, GoalPolicy, GoalQueue, GoalState, Progress
from server.graph import Graph, Subscriber
from server.moveit.goal_topics import RESULT_TOPIC, STATUS_TOPIC, GoalTopics
from server.moveit.goals import GoalTranslator, MotionRequest
from server.moveit.parameters import MoveItParameters
from server.node import Node

REGISTRY = Registry.load()
CLIENT = Node("client")


class Obedient:
    """Reaches every goal at once, unless it is told to wait."""

    def __init__(self) -> None:
        self.go_on = asyncio.Event()
        self.go_on.set()
        self.stopped: list[str] = []

    async def run(self, request: MotionRequest, report: Callable[[Progress], None]) -> Answer:
        report(Progress(GoalState.EXECUTING, "moving", 0.25, 1.5))
        await self.go_on.wait()
        return Answer(MoveItErrorCode.SUCCESS, "there")

    def stop(self, reason: str) -> None:
        self.stopped.append(reason)
        self.go_on.set()


class Desk:
    def __init__(self) -> None:
        self.graph = Graph(REGISTRY)
        self.runner = Obedient()
        topics = GoalTopics(self.graph, GoalTranslator(model.builtin(), MoveItParameters()))
        self.queue: GoalQueue[MotionRequest] = GoalQueue(
            self.runner, GoalPolicy.QUEUE, 4, topics.on_progress, topics.on_answer
        )
        self.queue.start()
        topics.open(self.queue)
        self.heard: dict[str, list[Any]] = {RESULT_TOPIC: [], STATUS_TOPIC: []}
        for topic, messages in self.heard.items():
            self.graph.subscribe(
                CLIENT, topic, None, Subscriber(lambda publication, to=messages: to.append(publication.msg))
            )

    async def publish(self, topic: str, message: dict[str, Any]) -> None:
        self.graph.publish(CLIENT, topic, message)
        for _ in range(10):
            await asyncio.sleep(0)


@pytest.fixture
async def desk() -> AsyncIterator[Desk]:
    made = Desk()
    yield made
    await made.queue.close(0.1)


def states(desk: Desk) -> list[str]:
    return [status["values"][0]["value"] for status in desk.heard[STATUS_TOPIC]]


async def test_a_goal_is_followed_and_answered_under_its_topic_and_id(desk: Desk) -> None:
    await desk.publish("/moveit_goal_named", {"data": "ready"})
    assert desk.heard[RESULT_TOPIC] == [{"val": 1, "message": "there", "source": "/moveit_goal_named#1"}]
    assert states(desk) == ["queued", "executing", "done"]
    moving = desk.heard[STATUS_TOPIC][1]
    assert (moving["name"], moving["hardware_id"], moving["level"]) == ("/moveit_goal_named", "1", 0)
    assert {pair["key"]: pair["value"] for pair in moving["values"]} == {
        "state": "executing",
        "fraction": "0.250",
        "seconds_left": "1.50",
    }


async def test_a_message_of_the_wrong_form_is_a_goal_that_is_refused(desk: Desk) -> None:
    with pytest.raises(MessageError):
        await desk.publish("/moveit_goal_joints", {"name": 5})
    assert [result["val"] for result in desk.heard[RESULT_TOPIC]] == [-16]
    assert "name" in desk.heard[RESULT_TOPIC][0]["message"]
    assert desk.heard[STATUS_TOPIC][-1]["level"] == 2


async def test_what_was_ignored_is_logged(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    await desk.publish("/moveit_goal_joints", {"name": ["knee", "elbow_flex"], "position": [1.0, 0.2]})
    assert "ignored joints that are not in group arm: knee" in caplog.text


@pytest.mark.parametrize(
    ("topic", "message"), [("/stop", {}), ("/trajectory_execution_event", {"data": "stop"})], ids=["/stop", "event"]
)
async def test_a_stop_reaches_the_arm_with_its_source(desk: Desk, topic: str, message: dict[str, Any]) -> None:
    desk.runner.go_on.clear()
    await desk.publish("/moveit_goal_named", {"data": "ready"})
    await desk.publish(topic, message)
    assert desk.runner.stopped == [f"stopped by {topic}"]


async def test_another_event_stops_nothing(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    await desk.publish("/trajectory_execution_event", {"data": "dance"})
    assert desk.runner.stopped == []
    assert "'dance'" in caplog.text
