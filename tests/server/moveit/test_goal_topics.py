from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest

from planners.problem import MoveItErrorCode
from protocol.errors import MessageError
from protocol.registry import Registry
from robot.description import model
from server.goal_queue import Answer, GoalPolicy, GoalQueue, GoalState, Progress
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.confirmation import Confirmation
from server.moveit.goal_topics import RESULT_TOPIC, STATUS_TOPIC, GoalTopics
from server.moveit.motions import Motion, PlannedMotion
from tests.helpers.arm_server import values_of
from tests.helpers.goal_translator import TRANSLATOR

REGISTRY = Registry.load()
CLIENT = Node("client")


class Obedient:
    """Reaches every goal at once, unless it is told to wait."""

    def __init__(self) -> None:
        self.go_on = asyncio.Event()
        self.go_on.set()
        self.stopped: list[str] = []
        self.ran: list[Motion] = []
        self.answer = Answer(MoveItErrorCode.SUCCESS, "there")

    async def run(self, request: Motion, report: Callable[[Progress], None]) -> Answer:
        self.ran.append(request)
        report(Progress(GoalState.EXECUTING, "moving", 0.25, 1.5))
        await self.go_on.wait()
        return self.answer

    def end(self, reason: str) -> None:
        self.stop(reason)

    def give_way(self, reason: str) -> None:
        self.stop(reason)

    def stop(self, reason: str) -> None:
        self.stopped.append(reason)
        self.go_on.set()


class Desk:
    def __init__(self) -> None:
        self.graph = Graph(REGISTRY)
        self.runner = Obedient()
        self.confirmation = Confirmation(self.graph, wanted=False, timeout_s=60.0)
        topics = GoalTopics(self.graph, model.builtin(), self.confirmation)
        self.queue: GoalQueue[Motion] = GoalQueue(
            self.runner, GoalPolicy.QUEUE, 4, topics.on_progress, topics.on_answer
        )
        self.queue.start()
        topics.open(self.queue, TRANSLATOR)
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


async def test_one_goal_is_cancelled_by_its_id(desk: Desk) -> None:
    desk.runner.go_on.clear()
    for name in ("ready", "home", "rest"):
        await desk.publish("/moveit_goal_named", {"data": name})
    await desk.publish("/moveit_goal_cancel", {"data": "2"})
    assert [(result["val"], result["source"]) for result in desk.heard[RESULT_TOPIC]] == [(-7, "/moveit_goal_named#2")]
    assert "/moveit_goal_cancel" in desk.heard[RESULT_TOPIC][0]["message"]
    await desk.publish("/moveit_goal_cancel", {"data": "99"})
    assert desk.runner.stopped == []
    await desk.publish("/moveit_goal_cancel", {"data": "1"})
    assert desk.runner.stopped == ["cancelled by /moveit_goal_cancel"]


async def test_the_last_status_has_the_code(desk: Desk) -> None:
    await desk.publish("/moveit_goal_named", {"data": "ready"})
    assert values_of(desk.heard[STATUS_TOPIC][-1])["code"] == "1"
    await desk.publish("/moveit_goal_named", {"data": "nowhere"})
    assert values_of(desk.heard[STATUS_TOPIC][-1])["code"] == "-16"


async def test_another_event_stops_nothing(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    await desk.publish("/trajectory_execution_event", {"data": "dance"})
    assert desk.runner.stopped == []
    assert "'dance'" in caplog.text


async def test_the_clients_own_stamp_comes_back_with_all_news_of_its_goal(desk: Desk) -> None:
    stamp = {"sec": 17, "nanosec": 4_000_001}
    await desk.publish("/moveit_goal_joints", {"header": {"stamp": stamp}, "name": ["elbow_flex"], "position": [0.2]})
    assert [values_of(status)["stamp"] for status in desk.heard[STATUS_TOPIC]] == ["17.004000001"] * 3


async def test_a_goal_that_would_work_is_ready_in_the_last_status_and_named_in_the_result(desk: Desk) -> None:
    await desk.publish("/moveit_goal_named", {"data": "redy"})
    values = values_of(desk.heard[STATUS_TOPIC][-1])
    suggested = json.loads(values["suggested_goal"])
    assert suggested == {"topic": "/moveit_goal_named", "type": "std_msgs/String", "msg": {"data": "ready"}}
    assert "'ready'" in desk.heard[RESULT_TOPIC][-1]["message"]
    await desk.publish(suggested["topic"], suggested["msg"])
    assert desk.heard[RESULT_TOPIC][-1]["val"] == 1


async def test_what_a_refusal_found_is_told_as_json(desk: Desk) -> None:
    pairs = [{"first": "gripper_link", "second": "mug", "depth_m": 0.01}]
    desk.runner.answer = Answer(MoveItErrorCode.GOAL_IN_COLLISION, "touches", {"pairs": pairs})
    await desk.publish("/moveit_goal_named", {"data": "home"})
    assert json.loads(values_of(desk.heard[STATUS_TOPIC][-1])["pairs"]) == pairs


async def test_goals_that_came_another_way_are_told_of_but_have_their_own_results(desk: Desk) -> None:
    desk.queue.submit("/move_action", PlannedMotion(()))
    for _ in range(10):
        await asyncio.sleep(0)
    assert desk.runner.ran
    assert {status["name"] for status in desk.heard[STATUS_TOPIC]} == {"/move_action"}
    assert desk.heard[RESULT_TOPIC] == []


@pytest.mark.parametrize("wanted", [True, False])
async def test_goals_are_to_be_confirmed_while_that_is_wanted(desk: Desk, *, wanted: bool) -> None:
    desk.confirmation.wanted = wanted
    await desk.publish("/moveit_goal_named", {"data": "home"})
    (ran,) = desk.runner.ran
    assert isinstance(ran, PlannedMotion)
    assert ran.confirm is wanted


async def test_a_goal_of_a_client_that_may_not_send_one_is_answered_to_it_alone(
    desk: Desk, caplog: pytest.LogCaptureFixture
) -> None:
    sender, answers = Node("sender", remote=True), []
    for topic in (RESULT_TOPIC, STATUS_TOPIC):
        desk.graph.subscribe(sender, topic, None, Subscriber(lambda publication: answers.append(publication.msg)))
    desk.graph.turn_away(sender, "/moveit_goal_named", {"data": "home"}, "another drives")
    status, result = answers
    assert result == {"val": -4, "message": "another drives", "source": "/moveit_goal_named#1"}
    assert (values_of(status)["state"], status["level"], status["hardware_id"]) == ("done", 2, "1")
    assert desk.heard == {RESULT_TOPIC: [], STATUS_TOPIC: []}
    assert desk.runner.ran == []
    assert not caplog.records
