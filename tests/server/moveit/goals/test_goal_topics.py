import asyncio
import json
from collections.abc import AsyncIterator, Mapping
from typing import Any

import pytest

from harness.clients import values_of
from protocol.errors import MessageError
from server.execution.goal import Answer, Goal, GoalState, Progress
from server.execution.queue import GoalListener
from server.graph.message_types import ReceivedMessage
from server.graph.permissions import Node
from server.graph.topics import Subscriber
from server.moveit.goals import goal_topics
from tests.helpers.fake_arm import settle
from tests.helpers.goal_runner import THERE
from tests.helpers.graph import listen
from tests.helpers.moveit import ROBOT, ActionDesk, translator

CLIENT = Node("client")


class Keeper(GoalListener):
    """Keeps the messages of answered goals."""

    def __init__(self, kept: list[Mapping[str, Any]]) -> None:
        self._kept = kept

    def on_answer(self, goal: Goal, answer: Answer) -> None:
        self._kept.append(goal.request.message)


class Desk(ActionDesk):
    """Reaches every goal at once, unless it is told to wait."""

    waits = False

    def __init__(self) -> None:
        super().__init__()
        node = self.graph.node("moveit")
        self.queue.listeners.append(goal_topics.GoalStatusTopics(node, ROBOT))
        goal_topics.GoalTopics(node, self.queue, translator(planning=self.context))
        self.heard = {
            topic: listen(self.graph, topic) for topic in (goal_topics.RESULT_TOPIC, goal_topics.STATUS_TOPIC)
        }

    async def run(self, goal: Goal) -> Answer:
        goal.report(Progress(GoalState.EXECUTING, "moving", 0.25, 1.5))
        if not self.waits:
            asyncio.get_running_loop().call_soon(self.finish)
        return await super().run(goal)

    async def publish(self, topic: str, message: object) -> None:
        self.graph.publish(CLIENT, topic, message)
        await settle()

    @property
    def answers(self) -> list[tuple[int, str, str]]:
        return [(each["val"], each["message"], each["source"]) for each in self.heard[goal_topics.RESULT_TOPIC]]


@pytest.fixture
async def desk() -> AsyncIterator[Desk]:
    made = Desk()
    yield made
    await made.close()


async def test_status_and_result_name_the_goals_topic_id_and_stamp(desk: Desk) -> None:
    await desk.publish("/moveit_goal_named", {"data": "ready"})
    assert desk.answers == [(1, THERE.message, "/moveit_goal_named#1")]
    queued, moving, done = desk.heard[goal_topics.STATUS_TOPIC]
    assert (values_of(queued)["state"], values_of(done)["state"]) == ("queued", "done")
    assert (moving["name"], moving["hardware_id"], moving["level"]) == ("/moveit_goal_named", "1", 0)
    assert values_of(moving) == {"state": "executing", "fraction": "0.250", "seconds_left": "1.50"}
    stamp = {"sec": 17, "nanosec": 4_000_001}
    await desk.publish("/moveit_goal_joints", {"header": {"stamp": stamp}, "name": ["elbow_flex"], "position": [0.2]})
    assert [values_of(status)["stamp"] for status in desk.heard[goal_topics.STATUS_TOPIC][3:]] == ["17.004000001"] * 3


async def test_a_bad_message_is_a_rejected_goal_or_is_logged(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(MessageError):
        await desk.publish("/moveit_goal_joints", {"name": 5})
    ((code, sentence, _source),) = desk.answers
    assert code == -16
    assert "name" in sentence
    assert desk.heard[goal_topics.STATUS_TOPIC][-1]["level"] == 2
    await desk.publish("/moveit_goal_joints", {"name": ["knee", "elbow_flex"], "position": [1.0, 0.2]})
    assert "ignored joints that are not in group arm: knee" in caplog.text
    await desk.publish("/trajectory_execution_event", {"data": "dance"})
    assert desk.stopped == []
    assert "'dance'" in caplog.text


@pytest.mark.parametrize(
    ("topic", "message", "limit"),
    [
        ("/moveit_goal_joints", {"name": ["knee"] * 201}, "at most 200 elements in all, got 201"),
        ("/moveit_goal_named", ReceivedMessage({"data": "x"}, 262_145), "at most 262144 bytes, got 262145"),
    ],
)
async def test_a_goal_of_any_size_is_refused_unread_and_not_kept(
    desk: Desk, topic: str, message: object, limit: str
) -> None:
    kept: list[Mapping[str, Any]] = []
    desk.queue.listeners.append(Keeper(kept))
    with pytest.raises(MessageError, match=limit):
        await desk.publish(topic, message)
    ((code, sentence, _source),) = desk.answers
    assert (code, limit in sentence, kept) == (-16, True, [{}])


@pytest.mark.parametrize(("topic", "message"), [("/stop", {}), ("/trajectory_execution_event", {"data": "stop"})])
async def test_a_stop_reaches_the_arm_with_its_source(desk: Desk, topic: str, message: dict[str, Any]) -> None:
    desk.waits = True
    await desk.publish("/moveit_goal_named", {"data": "ready"})
    await desk.publish(topic, message)
    assert desk.stopped == [None]
    assert desk.answers == [(-7, f"stopped by {topic}", "/moveit_goal_named#1")]


async def test_one_goal_is_cancelled_by_its_id(desk: Desk) -> None:
    desk.waits = True
    for name in ("ready", "home", "rest"):
        await desk.publish("/moveit_goal_named", {"data": name})
    for goal_id in ("2", "99", "1"):
        await desk.publish("/moveit_goal_cancel", {"data": goal_id})
    assert desk.stopped == []
    cancelled = "cancelled by /moveit_goal_cancel"
    assert desk.answers == [
        (-7, f"{cancelled} before this goal's turn came", "/moveit_goal_named#2"),
        (-7, cancelled, "/moveit_goal_named#1"),
    ]


async def test_a_suggested_goal_is_in_the_final_status_and_named_in_the_result(desk: Desk) -> None:
    await desk.publish("/moveit_goal_named", {"data": "redy"})
    suggested = json.loads(values_of(desk.heard[goal_topics.STATUS_TOPIC][-1])["suggested_goal"])
    assert suggested == {"topic": "/moveit_goal_named", "type": "std_msgs/String", "msg": {"data": "ready"}}
    assert "'ready'" in desk.answers[-1][1]
    await desk.publish(suggested["topic"], suggested["msg"])
    assert desk.answers[-1][0] == 1


@pytest.mark.parametrize("wanted", [True, False])
async def test_goals_wait_for_confirmation_while_that_is_wanted(desk: Desk, *, wanted: bool) -> None:
    desk.context.confirmation.enabled = wanted
    await desk.publish("/moveit_goal_named", {"data": "home"})
    assert [motion.confirm for motion in desk.asked] == [wanted]


async def test_the_refusal_of_a_goal_goes_to_its_sender_alone(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    sender, answers = Node("sender", remote=True), []
    for topic in (goal_topics.RESULT_TOPIC, goal_topics.STATUS_TOPIC):
        desk.graph.subscribe(sender, topic, None, Subscriber(lambda published: answers.append(published.msg)))
    desk.graph.reject_unauthorized(sender, "/moveit_goal_named", {"data": "home"}, "another drives")
    status, result = answers
    assert result == {"val": -4, "message": "another drives", "source": "/moveit_goal_named#1"}
    assert (values_of(status)["state"], status["level"], status["hardware_id"]) == ("done", 2, "1")
    assert desk.heard == {goal_topics.RESULT_TOPIC: [], goal_topics.STATUS_TOPIC: []}
    assert desk.asked == []
    assert not caplog.records


GROUP_TOPIC = "/moveit_goal_group"


async def test_the_group_of_goals_is_latched_and_can_be_chosen(desk: Desk) -> None:
    assert listen(desk.graph, GROUP_TOPIC)[-1]["data"] == "arm"
    for wanted, told in (("gripper", "gripper"), ("legs", "gripper"), ("", "arm")):
        await desk.publish(GROUP_TOPIC, {"data": wanted})
        assert listen(desk.graph, GROUP_TOPIC)[-1]["data"] == told
    status = desk.heard[goal_topics.STATUS_TOPIC][-1]
    assert (status["level"], status["name"]) == (2, GROUP_TOPIC)
    assert "there is no planning group 'legs'; there are: arm" in status["message"]
    assert desk.answers == []
